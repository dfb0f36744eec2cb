"""Patterns that images show, whatever is described: markers, a chessboard, a grid of circles, tags."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import PatternKind, PlacedTag
from calibration.robot.labelling.aprilgrid import BORDER_MODULES
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.markers import MarkerFinder, Markers
from calibration.robot.labelling.unmarked_grids import LEAST_CIRCLES, blob_finder

MIN_BOARD_MARKERS = 6
"""Least number of markers in one image that indicate a board, also for a chessboard."""
MIN_TAG_IMAGES = 2
"""Least number of images with one id, half of them at least, that indicate a tag: clutter reads as one id once."""
LEAST_BOARD = (4, 4)
"""Corners of the smallest chessboard that is looked for."""
MAX_BOARD_SEARCHES = 4
"""Images that are searched for a chessboard or circles of unknown number, which takes long where there are none."""
MIN_GRID_CIRCLES, MAX_GRID_CIRCLES = 20, 400
"""Limits of the number of circles in a grid of an unknown number of rows; fewer are found in clutter."""
MAX_ALIKE = 1.4
"""Limit of the ratio of the sizes, and of the distances, of neighbouring circles of a grid that is tilted."""
_DICTIONARY_SIZES = (50, 100, 250, 1000)


@dataclass(frozen=True)
class Family:
    """Markers of one kind."""

    dictionary: str
    """Largest dictionary of its kind."""
    border: int = 1
    """Width of the black border around the bits, in modules."""

    def finder(self) -> MarkerFinder:
        """Return a detector of all its markers."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return MarkerFinder(dictionary, len(dictionary.bytesList), self.border)

    def named(self, highest: int) -> str:
        """Return the smallest dictionary with the marker of this id: the smaller ones are subsets of the largest."""
        kind, _, size = self.dictionary.rpartition("_")
        return f"{kind}_{next(n for n in _DICTIONARY_SIZES if highest < n)}" if size == "1000" else self.dictionary


APRILGRID_FAMILY = Family(APRILGRID_TAGS, BORDER_MODULES)
"""Markers of an aprilgrid."""
MARKER_FAMILIES = (
    APRILGRID_FAMILY,
    *(Family(f"DICT_{bits}X{bits}_1000") for bits in (4, 5, 6, 7)),
    *(Family(f"DICT_APRILTAG_{kind}") for kind in ("25h9", "36h10", "36h11")),
)


def shown_markers(images: Sequence[Image], small: bool = False) -> dict[Family, list[Markers]]:
    """Return the markers of each family in each of some grey images, on request also small ones, which takes long."""
    found = {
        family: [finder.find_small(image) if small else finder.find(image) for image in images]
        for family in MARKER_FAMILIES
        if (finder := family.finder())
    }
    if max(map(len, found[APRILGRID_FAMILY]), default=0) > 1:
        del found[Family(APRILGRID_TAGS)]  # with a border of one module the same tags decode differently
    return found


def shown_board(found: Mapping[Family, Sequence[Markers]]) -> tuple[Family, int] | None:
    """Return the family of the most markers in some images (`shown_markers`), and the highest id; None of a few."""
    best = max(found, key=lambda family: sum(map(len, found[family])))
    if max(map(len, found[best]), default=0) < MIN_BOARD_MARKERS:
        return None
    return best, max(int(each.ids.max()) for each in found[best] if len(each))


def shown_tags(found: Mapping[Family, Sequence[Markers]]) -> PatternConfiguration | None:
    """Return the tags, of those in some images (`shown_markers`), that are in most; None if there are none.

    Of their sizes and places nothing is known.
    """
    of_family = {family: _repeated_ids(each) for family, each in found.items() if family != APRILGRID_FAMILY}
    family = max(of_family, key=lambda each: max(of_family[each].values(), default=0))
    tags = tuple(PlacedTag(id=number, size=1.0) for number in sorted(of_family[family]))
    if not tags:
        return None
    return _pattern_of_unit_size("tags", (len(tags), 1), dictionary=family.named(tags[-1].id), tags=tags)


def _repeated_ids(found: Sequence[Markers]) -> dict[int, int]:
    """Return in how many images each of the ids is that clutter does not explain."""
    counts = Counter(number for markers in found for number in markers.ids.tolist())
    least = max(MIN_TAG_IMAGES, len(found) / 2)
    return {number: count for number, count in counts.items() if count >= least}


def shown_chessboard(images: Sequence[Image]) -> PatternConfiguration | None:
    """Return the chessboard, of any number of squares, in one of some grey images; None without one."""
    for image in _some_images(images):
        found, _, meta = cv2.findChessboardCornersSBWithMeta(image, LEAST_BOARD, cv2.CALIB_CB_LARGER)
        rows, columns = meta.shape[:2] if found else (0, 0)
        if found and _is_in(
            image, board := _pattern_of_unit_size("chessboard", (columns, rows))
        ):  # OpenCV's search takes circles
            return board
    return None


def shown_circles(images: Sequence[Image]) -> PatternConfiguration | None:
    """Return the grid of circles, of any number of rows, in two of some grey images, or in the only one; else None.

    As many alike dark spots as are next to each other are the circles of a grid, whose columns and rows are factors of
    their number.
    """
    some = _some_images(images)
    for image in some:
        spots = cv2.SimpleBlobDetector.detect(blob_finder(image.size / MIN_GRID_CIRCLES), image)
        count, gap, diameter = _count_neighbouring(
            np.array([spot.pt for spot in spots]).reshape(-1, 2), np.array([spot.size for spot in spots])
        )
        is_grid = MIN_GRID_CIRCLES <= count <= MAX_GRID_CIRCLES and diameter < gap
        for kind, columns, rows in _grids_of_count(count) if is_grid else ():
            nearest = np.sqrt(2) if kind == "asymmetric-circles" else 1.0
            grid = _pattern_of_unit_size(kind, (columns, rows), inner_size=diameter / gap * nearest)
            if sum(_is_in(each, grid) for each in some) >= min(2, len(some)):
                return grid
    return None


def _grids_of_count(count: int) -> Iterator[tuple[PatternKind, int, int]]:
    """Yield the grids of a number of circles: columns and rows."""
    for columns in range(LEAST_CIRCLES, count // LEAST_CIRCLES + 1):
        rows, rest = divmod(count, columns)
        if not rest and rows <= columns:
            yield "circles", columns, rows
        if not rest and rows % 2:
            yield "asymmetric-circles", columns, rows


def _count_neighbouring(places: "np.ndarray[Any, Any]", sizes: "np.ndarray[Any, Any]") -> tuple[int, float, float]:
    """Return the number of spots (N, 2) that are next to ones alike, the most; their distance and diameter, px."""
    if len(places) < MIN_GRID_CIRCLES:
        return 0, 1.0, 1.0
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(0)
    alike = np.maximum(sizes[:, None] / sizes, sizes / sizes[:, None]) < MAX_ALIKE
    linked = alike & (apart < MAX_ALIKE * np.minimum(nearest[:, None], nearest))
    groups = np.arange(len(places))
    for _ in range(len(places)):
        joined = np.minimum(groups, np.where(linked, groups, len(groups)).min(1))
        if (joined == groups).all():
            break
        groups = joined
    members = groups == np.bincount(groups).argmax()
    return int(members.sum()), float(np.median(nearest[members])), float(np.median(sizes[members]))


def _is_in(image: Image, pattern: PatternConfiguration) -> bool:
    return isinstance(corner_detector(pattern).detect(image), CornerLabels)


def _some_images(images: Sequence[Image]) -> Sequence[Image]:
    return images[:: -(-len(images) // MAX_BOARD_SEARCHES)] if images else ()


def _pattern_of_unit_size(kind: PatternKind, dimension: tuple[int, int], **more: Any) -> PatternConfiguration:
    """Return a pattern of unknown size: its unit is the distance of its corners."""
    return PatternConfiguration(kind, kind, kind, "world", fixed=False, dimension=dimension, size=1.0, **more)
