"""Patterns that images show where the described one is not found, and the reasons why it is not."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import CIRCLE_KINDS, UNMARKED_KINDS, PatternKind, PlacedTag
from calibration.robot.importing.image_views import View, read_image
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image, grey
from calibration.robot.labelling.marked_boards import BORDER_MODULES, CharucoDetector
from calibration.robot.labelling.markers import MarkerFinder, Markers, turned_tags
from calibration.robot.labelling.unmarked_grids import LEAST_CIRCLES, blob_finder, reduced_images

MIN_BOARD_MARKERS = 6
"""Least number of markers in one image that indicate a board, also for a chessboard."""
MIN_TAG_IMAGES = 2
"""Least number of images with one id, half of them at least, that indicate a tag: clutter reads as one id once."""
LEAST_BOARD = (4, 4)
"""Corners of the smallest chessboard that is looked for."""
WHOLE_BOARD = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
"""Search for all corners of a board of unknown size: without the second, of 12 x 19 corners a part is found."""
MAX_BOARD_SEARCHES = 4
"""Images that are searched for a chessboard or circles of unknown number, which takes long where there are none."""
MIN_GRID_CIRCLES, MAX_GRID_CIRCLES = 20, 400
"""Limits of the number of circles in a grid of an unknown number of rows; fewer are found in clutter."""
MAX_ALIKE = 1.4
"""Limit of the ratio of the sizes, and of the distances, of neighbouring circles of a grid that is tilted."""
_DICTIONARY_SIZES = (50, 100, 250, 1000)
LOOKED_AT = 8
"""Number of images that are searched for other patterns."""
IN_PLACE = 0.5
"""Least share of neighbouring markers that are where the described board has them."""
GAP_OFF = 0.2
"""Tolerance of the gaps between tags, in sides of a tag: small tags are blurred."""
SPACING_OFF = 0.02
"""Limit of the error of a described gap between tags, in sides of a tag."""
LEAST_GAPS = 10
"""Minimum of gaps by which a described one is judged."""


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
        _, smaller = next(reduced_images(image))
        found, _, meta = cv2.findChessboardCornersSBWithMeta(smaller, LEAST_BOARD, WHOLE_BOARD)
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


def never_seen(
    sensor: str, pattern: PatternConfiguration, views: Sequence[View], read: Callable[[int], Image]
) -> InputError:
    """Return the error for a pattern that is in none of a camera's images, with the most similar pattern found.

    Args:
        sensor: the camera.
        pattern: the described pattern.
        views: of all its images, at least one.
        read: function that returns the image of a view, by index.
    """
    step = -(-len(views) // LOOKED_AT)
    images = [grey(read(i)) for i in range(0, len(views), step)]
    hint = _otherwise_printed(pattern, images)
    if pattern.inverted:
        images = [np.bitwise_not(image) for image in images]
    hint = hint or _describe_markers(pattern, images)
    if pattern.kind == "chessboard":
        hint = hint or _describe_chessboard(pattern, images)
    if pattern.kind in CIRCLE_KINDS:
        hint = hint or _describe_circles(pattern, images)
    reasons = Counter(view.found[pattern.name].reason for view in views)
    usual = f"; in most images: {reasons.most_common(1)[0][0]}" if not hint else ""
    return InputError(
        f"'{sensor}' sees pattern '{pattern.name}' ({_describe_pattern(pattern)}) in none of its {len(views)} "
        f"images{hint}{usual}"
    )


def _otherwise_printed(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Say whether the pattern is in the images with black and white exchanged, or mirrored; markers tell it."""
    if pattern.kind == "chessboard":
        return ""
    detector = corner_detector(pattern)
    inverted = f"the board's colours are {'not ' if pattern.inverted else ''}inverted"
    mirrored = "it is seen from its back, mirrored"
    for hint, changed in (
        (f"; {inverted}: add 'inverted: {'false' if pattern.inverted else 'true'}' to the pattern", np.bitwise_not),
        (f"; {mirrored}: turn its printed side to this camera", np.fliplr),
        (f"; {inverted}, and {mirrored}", lambda image: np.bitwise_not(np.fliplr(image))),
    )[: 1 if pattern.kind in CIRCLE_KINDS else 3]:  # most grids of circles look the same mirrored
        if any(isinstance(detector.detect(np.ascontiguousarray(changed(i))), CornerLabels) for i in images):
            return hint
    return ""


def _describe_pattern(pattern: PatternConfiguration) -> str:
    size = f"{pattern.kind}, {pattern.dimension[0]} x {pattern.dimension[1]}"
    if pattern.kind == "aprilgrid":
        return f"{size} tags"
    if pattern.kind == "tags":
        return f"tags {', '.join(str(tag.id) for tag in pattern.tags)} of {pattern.dictionary}"
    if pattern.kind in CIRCLE_KINDS:
        return size
    dictionary = f", {pattern.dictionary}" if pattern.dictionary else ""
    return f"{size} corners{dictionary}"


def _describe_markers(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Describe the markers of the family with most detections."""
    plain = shown_markers(images)
    family = max(plain, key=lambda each: max(map(len, plain[each])))
    if max(map(len, plain[family])) < {"tags": 1, **dict.fromkeys(UNMARKED_KINDS, MIN_BOARD_MARKERS)}.get(
        pattern.kind, 2
    ):
        return "" if pattern.kind in UNMARKED_KINDS else "; no markers of 4x4 to 7x7 bits and no tags are found either"
    found = [max(one, family.finder().find_small(i), key=len) for one, i in zip(plain[family], images, strict=True)]
    seen = max(found, key=len)
    many = np.concatenate([markers.ids for markers in found if len(markers) > len(seen) / 2])
    lowest, highest = int(many.min()), int(many.max())
    if pattern.kind == "tags":
        return f"; found {family.named(highest)} with ids {lowest} to {highest}"
    if pattern.kind in UNMARKED_KINDS:
        return f"; found {len(seen)} markers of {family.named(highest)}: is it a charuco board or an aprilgrid?"
    if pattern.kind == "aprilgrid":
        return _describe_tags(pattern, family, lowest, highest, seen)
    if family.border > 1 or family.named(0).rpartition("_")[0] != (pattern.dictionary or "").rpartition("_")[0]:
        return f"; found {len(seen)} markers of another dictionary, {family.named(highest)}"
    expected = marker_ids(pattern)
    if other_first := _other_first(pattern, "markers", lowest, highest):
        return other_first
    if highest != expected[-1]:
        return (
            f"; found its markers with ids up to {highest}, expected {expected[0]} to {expected[-1]}: are columns and "
            f"rows those of the printed board (corners inside: squares less one)?"
        )
    return f"; found {len(seen)} of its markers, not as a board of this size has them: are columns and rows exchanged?"


def _other_first(pattern: PatternConfiguration, markers: str, lowest: int, highest: int) -> str:
    """Say that the ids of the found markers begin elsewhere, if they are as many as the board has, or all others."""
    expected = marker_ids(pattern)
    count = highest - lowest + 1
    if lowest == expected[0] or count > len(expected) or (lowest <= expected[-1] and count < len(expected)):
        return ""
    return (
        f"; found its {markers} with ids {lowest} to {highest}, expected {expected[0]} to {expected[-1]}: the ids "
        f"begin at {lowest}: add 'first: {lowest}' to the pattern"
    )


def _describe_tags(pattern: PatternConfiguration, family: Family, lowest: int, highest: int, seen: Markers) -> str:
    """Describe the differences of an image's tags from an aprilgrid."""
    if family != APRILGRID_FAMILY:
        border = (
            " with a border of one module, expected two, as Kalibr prints them"
            if family.dictionary == APRILGRID_TAGS
            else ""
        )
        other = border or f", expected {APRILGRID_TAGS}"
        return f"; found {len(seen)} markers of {family.named(highest)}{other}"
    expected, gap = marker_ids(pattern), _median_gap(seen)
    if other_first := _other_first(pattern, "tags", lowest, highest):
        return other_first
    if highest == expected[-1] and 0 < gap < 1 and abs(gap - pattern.spacing) > GAP_OFF:
        return (
            f"; found {len(seen)} of its tags, with gaps of about {gap:.1f} sides of a tag, expected "
            f"{pattern.spacing:g}: spacing is the gap by the side of a tag, both in one unit"
        )
    if highest != expected[-1]:
        return (
            f"; found its tags with ids up to {highest}, expected {expected[0]} to {expected[-1]}: are columns and "
            "rows those of the printed board (tags)?"
        )
    return (
        f"; found {len(seen)} of its tags, not as a board of this size has them: are columns and rows exchanged, or is "
        "it not printed by Kalibr (tag 0 at the bottom left, its corner squares black)?"
    )


def _median_gap(seen: Markers) -> float:
    """Return the median gap between neighbours in a row, in sides of a tag; NaN if no two are detected."""
    (first,) = np.nonzero(np.diff(seen.ids) == 1)
    corners = np.roll(seen.corners, -turned_tags(), axis=1)  # from the top left
    right, left = corners[first, 2], corners[first, 3]
    gaps = np.linalg.norm(corners[first + 1, 3] - right, axis=-1) / np.linalg.norm(right - left, axis=-1)
    return float(np.median(gaps)) if len(gaps) else np.nan


def marker_ids(pattern: PatternConfiguration) -> Sequence[int]:
    """Ids of a charuco board's markers, of an aprilgrid's tags, or of single tags; none of another pattern."""
    if pattern.kind == "tags":
        return sorted(tag.id for tag in pattern.tags)
    columns, rows = pattern.dimension
    count = {"aprilgrid": columns * rows, "charuco": (columns + 1) * (rows + 1) // 2}.get(pattern.kind, 0)
    return range(pattern.first_marker, pattern.first_marker + count)


def check_told_apart(patterns: Mapping[str, PatternConfiguration]) -> None:
    """Refuse boards of one dictionary that share ids: each would be found on the other.

    Raises:
        InputError: names two of them.
    """
    for one, other in combinations((each for each in patterns.values() if marker_ids(each)), 2):
        ids, others = marker_ids(one), marker_ids(other)
        alike = (one.dictionary, one.kind, one.inverted) == (other.dictionary, other.kind, other.inverted)
        if alike and set(ids) & set(others):
            raise InputError(
                f"patterns '{one.name}' and '{other.name}' have markers of {one.dictionary} with ids {ids[0]} to "
                f"{ids[-1]} and {others[0]} to {others[-1]}, expected no id on both: print them with other ids, and "
                "say where they begin (first: 27)"
            )


def _describe_chessboard(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Describe a chessboard of another size."""
    shown = shown_chessboard(images)
    if shown is None or sorted(shown.dimension) == sorted(pattern.dimension):
        return ""
    columns, rows = sorted(shown.dimension, reverse=pattern.dimension[0] > pattern.dimension[1])
    return (
        f"; found one of {columns} x {rows} corners: are columns and rows those of the printed board "
        "(corners inside: squares less one)?"
    )


def _describe_circles(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Describe a grid of circles of another kind or size."""
    shown = shown_circles(images)
    if shown is None or (shown.kind, sorted(shown.dimension)) == (pattern.kind, sorted(pattern.dimension)):
        return ""
    return f"; found {_describe_pattern(shown)}: are type, columns and rows those of the printed grid?"


def check_board(
    sensor: str, pattern: PatternConfiguration, views: Sequence[View], others: Iterable[PatternConfiguration] = ()
) -> None:
    """Refuse a board whose detected markers belong to another board than described.

    Markers that the described board lacks, in most of the searched images, are the rest of a larger one. Markers that
    are not where the described board has them are those of a board with other columns and rows.

    Args:
        sensor: the camera.
        pattern: the described board.
        views: of the camera.
        others: other boards, whose markers may be seen too.

    Raises:
        InputError: names the highest marker, or asks whether columns and rows are exchanged.
    """
    if pattern.kind in (*UNMARKED_KINDS, "tags") or not pattern.dictionary:
        return
    expected = marker_ids(pattern)
    of_others = [n for each in others if each.dictionary == pattern.dictionary for n in marker_ids(each)]
    finder = (APRILGRID_FAMILY if pattern.kind == "aprilgrid" else Family(pattern.dictionary)).finder()
    labelled = [view for view in views if view.found[pattern.name].ids]
    charuco = CharucoDetector(pattern) if pattern.kind == "charuco" else None
    strange, misplaced = [], 0
    for view in labelled[:: -(-len(labelled) // LOOKED_AT) or 1]:
        image = grey(read_image(Path(view.file)))
        markers = finder.find_small(np.bitwise_not(image) if pattern.inverted else image)
        strange.append(int(np.max(np.setdiff1d(markers.ids, [*expected, *of_others]), initial=-1)))
        misplaced += charuco is not None and charuco.in_place(markers) < IN_PLACE
    if sum(highest >= 0 for highest in strange) > len(strange) / 2:
        marker, corners, counted = (
            ("tag", "tags", "tags")
            if pattern.kind == "aprilgrid"
            else ("marker", "corners", "corners inside: squares less one")
        )
        raise InputError(
            f"'{sensor}' sees {marker} {max(strange)} of {pattern.dictionary}, expected {expected[0]} to "
            f"{expected[-1]}, as pattern '{pattern.name}' of {pattern.dimension[0]} x {pattern.dimension[1]} {corners} "
            f"has: are columns and rows those of the printed board ({counted})?"
        )
    if misplaced > len(strange) / 2:
        raise InputError(
            f"'{sensor}' sees markers of {pattern.dictionary}, but not where pattern '{pattern.name}' of "
            f"{pattern.dimension[0]} x {pattern.dimension[1]} corners has them: are columns and rows those of the "
            "printed board (corners inside: squares less one), or exchanged?"
        )


def check_spacing(sensor: str, pattern: PatternConfiguration, views: Sequence[View]) -> None:
    """Refuse an aprilgrid whose images show another gap between tags than described.

    The begins and ends of two neighbouring tags are four points of a line, whose cross-ratio is the same in any image:
    ``(1 + s)^2 / (s (2 + s))`` for a gap of s sides of a tag. A lens bends lines little over two tags.

    Raises:
        InputError: states the gap.
    """
    if pattern.kind != "aprilgrid":
        return
    seen = np.concatenate(
        [_tag_spacings(pattern, labels) for view in views if (labels := view.found[pattern.name].labels)]
    )
    if len(seen) < LEAST_GAPS:
        return
    shown = float(np.median(seen))
    if abs(shown - pattern.spacing) > SPACING_OFF:
        raise InputError(
            f"'{sensor}': pattern '{pattern.name}' has a spacing of {pattern.spacing:g}, the images show {shown:.3f} "
            f"({len(seen)} gaps): spacing is the gap between two tags by the side of a tag: measure both again"
        )


def _tag_spacings(pattern: PatternConfiguration, labels: CornerLabels) -> Array:
    """Return the gaps (N,) between the neighbouring tags of a view, in sides of a tag."""
    columns, rows = pattern.dimension
    places = np.full((2 * rows * 2 * columns, 2), np.nan)
    places[labels.ids] = labels.pixels
    across = places.reshape(2 * rows, 2 * columns, 2)
    found = []
    for lines in (across, across.swapaxes(0, 1)):
        a, b, c, d = (lines[:, i : lines.shape[1] - 3 + i : 2] for i in range(4))
        ac, bd, bc, ad = (np.linalg.norm(q - p, axis=-1).ravel() for p, q in ((a, c), (b, d), (b, c), (a, d)))
        ratio = ac * bd / (bc * ad)
        ratio = ratio[np.isfinite(ratio)]
        found.append(np.sqrt(ratio / (ratio - 1)) - 1)
    return np.concatenate(found)
