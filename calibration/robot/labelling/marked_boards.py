"""Boards with markers, in whole or partial views: charuco boards, and the aprilgrids that Kalibr prints.

OpenCV reads the markers; the corners are found from them (`calibration.robot.labelling.board_corners`). OpenCV's own
corners of tags are about 3 px off, because the squares at the corners touch the tags.

Ids of a charuco board are ATOM's: ``row * columns + column`` in the pattern's frame, x along a row, y along a column, z
away from the camera, as in OpenCV's board since 4.6; labels by ATOM with OpenCV 4.6 have the same ids
(tested on real data). Their pixels are half a pixel larger in x and y: that version has its
origin at the corner of the top-left pixel; here the pixel's centre is (0, 0).

An aprilgrid has tags of AprilTag's family 36h11 with a border of two modules, upright as AprilTag draws them, and a
black square at each crossing of gaps, so that four quarters of black and white meet in every corner of a tag. The
print consists of cells: a gap, the modules of a tag, a gap, and so on. Ids are Kalibr's
(`calibration.engine.dataset.pattern.tag_grid`).

Positions on it are from the top left corner of the print; x to the right, y down. The unit is about the mean distance
of corners in a row, so that detectors search as far as on a board of squares.
"""

import math
from functools import lru_cache

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.configuration import APRILGRID_TAGS, TAG_COUNT, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import tag_grid, tag_lines, tag_outline
from calibration.robot.labelling import board_corners
from calibration.robot.labelling.board_image import TEXELS_PER_SQUARE, PrintedPatches
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.markers import WINDOWS_FOR_TOUCHED, MarkerFinder, Markers, turned_tags

LEAST_MARKERS = 8
"""A detection takes more markers than this, and enough corners (ATOM's rule).

A board with fewer than 33 markers takes more than a quarter of them.
"""


class CharucoDetector:
    """Corner detector of one charuco board; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for a printed pattern; OpenCV's modern or legacy layout is detected in each image.

        Raises:
            InputError: such a board cannot be printed.
        """
        dictionary = _opencv_dictionary(pattern)
        columns, rows = pattern.dimension
        row, column = np.divmod(np.arange(columns * rows), columns)
        self._corners = np.stack([column + 1.0, row + 1.0], -1)
        markers = (columns + 1) * (rows + 1) // 2
        available = len(dictionary.bytesList)
        first = pattern.first_marker
        if first + markers > available:
            begin = f" from id {first} on" if first else ""
            raise InputError(
                f"pattern '{pattern.name}': a charuco board of {columns} x {rows} corners has {markers} markers{begin}"
                f", {pattern.dictionary} has {available}: name a larger dictionary"
            )
        if pattern.inner_size is None:
            raise InputError(f"pattern '{pattern.name}': a charuco board needs inner_size, the side of its markers")
        marker = pattern.inner_size / pattern.size
        self._clearance = (1 - marker) / 2
        self._first = first
        self._needed = min(LEAST_MARKERS, markers // 4)
        self._finder = MarkerFinder(dictionary, markers, first=first)
        self._layouts = board_corners.board_layouts(columns + 1, rows + 1, marker, dictionary, self._corners, first)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < 2 * MarkerFinder.LEAST_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no pattern")
        found = self._read_markers(image)
        count = len(found[0].markers) if found else 0
        if count <= self._needed:
            return NotDetected(f"{count} markers, more than {self._needed} are needed")
        candidates = [board_corners.find_corners(image, reading, self._corners, self._clearance) for reading in found]
        candidates.sort(key=lambda candidate: -len(candidate[0]))
        ids, pixels = candidates[0]
        labels = board_corners.enough(self._corners, ids, pixels)
        if isinstance(labels, CornerLabels) and len(candidates) > 1 and len(candidates[1][0]) == len(ids):
            return NotDetected("too little is seen to tell in which of OpenCV's two layouts the board is printed")
        return labels

    def in_place(self, markers: Markers) -> float:
        """Return the share of an image's neighbouring markers that are where the board has them, 0 to 1.

        Args:
            markers: with the ids of the dictionary.
        """
        own = markers.ids - self._first
        known = (own >= 0) & (own < len(self._layouts[0].markers))
        return board_corners.neighbours_in_place(self._layouts, Markers(own[known], markers.corners[known]))

    def _read_markers(self, image: Image) -> list[board_corners.Reading]:
        """Read the markers by the likeliest layouts; repeated at a finer scale if many expected ones are missing."""
        found = board_corners.readings(self._layouts, self._finder.find(image))
        if found and found[0].share(*image.shape) >= 0.5:
            return found
        finer = board_corners.readings(
            self._layouts, self._finder.find_small(image, found[0].box(*image.shape) if found else None)
        )
        return max(found, finer, key=lambda r: len(r[0].markers) if r else 0)


def _opencv_dictionary(pattern: PatternConfiguration) -> "cv2.aruco.Dictionary":
    name = pattern.dictionary or ""
    known = sorted(key for key in dir(cv2.aruco) if key.startswith("DICT_") and "X" in key)
    if name not in known:
        raise InputError(
            f"pattern '{pattern.name}': found dictionary '{name}', expected one of OpenCV's: {', '.join(known)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


BORDER_MODULES = 2
"""Width of the black border around the bits of a tag, in modules."""
MODULES_PER_TAG = 6 + 2 * BORDER_MODULES
"""Modules along the side of a tag."""
UNIT_STRETCH = 1.15
"""Unit in mean distances of corners in a row: at 1 and at 1.3 fewer corners are found."""


def tag_dictionary() -> "cv2.aruco.Dictionary":
    """Return OpenCV's dictionary of the tags."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, APRILGRID_TAGS))


@lru_cache(maxsize=8)
def tag_cells(columns: int, rows: int, first: int = 0) -> BoolArray:
    """Return a mask (rows * (MODULES + 1) + 1, columns * (MODULES + 1) + 1) of the black cells; ids from `first`."""
    step, dictionary = MODULES_PER_TAG + 1, tag_dictionary()
    black = np.zeros((rows * step + 1, columns * step + 1), bool)
    black[::step, ::step] = True
    for tag in range(rows * columns):
        row, column = divmod(tag, columns)
        top, left = (rows - 1 - row) * step + 1, column * step + 1
        drawn = np.asarray(
            cv2.aruco.generateImageMarker(dictionary, first + tag, MODULES_PER_TAG, borderBits=BORDER_MODULES)
        )
        black[top : top + MODULES_PER_TAG, left : left + MODULES_PER_TAG] = np.rot90(drawn < 128, turned_tags())
    black.flags.writeable = False
    return black


def unit(spacing: float) -> float:
    """Length of the unit, in sides of a tag."""
    return UNIT_STRETCH * (1 + spacing) / 2


def cell_ends(columns: int, rows: int, spacing: float) -> tuple[Array, Array]:
    """Return the boundaries of the cells, in sides of a tag from 0: along x and along y."""
    return _module_ends(columns, spacing), _module_ends(rows, spacing)


def _module_ends(count: int, spacing: float) -> Array:
    begins = tag_lines(count, 1.0, spacing)[::2] + spacing
    cells = begins[:, None] + np.array([-spacing, *(np.arange(MODULES_PER_TAG) / MODULES_PER_TAG)])
    return np.concatenate([cells.ravel(), begins[-1] + [1.0, 1.0 + spacing]])


def corner_places(columns: int, rows: int, spacing: float) -> Array:
    """Return the corners of the tags (4 * columns * rows, 2), by id, in units."""
    side = 1 / unit(spacing)
    top_left = tag_outline(columns, rows, side, spacing, (0.0, 0.0))[0]
    places: Array = tag_grid(columns, rows, side, spacing)[:, :2] - top_left
    return places


def corner_ids(columns: int, rows: int) -> IntArray:
    """Return the ids (columns * rows, 4) of the corners of each tag, in OpenCV's order of detection.

    Clockwise from the top left of OpenCV's drawing of a tag: with OpenCV 4 the bottom right.
    """
    row, column = np.divmod(np.arange(columns * rows), columns)
    bottom_left = 4 * columns * row + 2 * column
    upright = np.array([2 * columns, 2 * columns + 1, 1, 0])
    ids: IntArray = bottom_left[:, None] + np.roll(upright, turned_tags())
    return ids


def drawn(columns: int, rows: int, spacing: float, texels: int, first: int = 0) -> Image:
    """Draw the print, black and white; `texels` is the number of texels per unit, `first` the lowest id of its tags."""
    tag = texels / unit(spacing)
    across, down = (
        np.searchsorted(ends, (np.arange(int(ends[-1] * tag)) + 0.5) / tag) - 1
        for ends in cell_ends(columns, rows, spacing)
    )
    return np.where(tag_cells(columns, rows, first)[down[:, None], across], 0, 255).astype(np.uint8)


LEAST_TAGS = 2
"""Minimum of tags: a single one may be a false detection in noise."""
LEAST_AGREEING = 0.5
"""Minimum share of all tags that match the board; with less it is another board, and a few match by chance."""
LEAST_FREE = 3.0
"""Corners of smaller tags (below 15 px, by the usual spacing) are skipped: the print next to them biases them. Measured
errors are 0.05 px for squares wider than 20 px, 0.2 px and more at 14 px.
"""
LEAST_ANGLE = math.radians(25)
"""Corners whose edges meet at a smaller angle are skipped: blur fills the wedge (0.2 to 2.4 px off)."""


class AprilgridDetector:
    """Corner detector of one aprilgrid; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for a printed pattern.

        Raises:
            InputError: such a board cannot be printed.
        """
        columns, rows = pattern.dimension
        first = pattern.first_marker
        if first + columns * rows > TAG_COUNT:
            raise InputError(f"pattern '{pattern.name}': found {columns} x {rows} tags, expected {TAG_COUNT} at most")
        self._corners = corner_places(columns, rows, pattern.spacing)
        self._clearance = min(pattern.spacing, BORDER_MODULES / MODULES_PER_TAG) / unit(pattern.spacing)
        self._first, self._count = first, columns * rows
        self._finder = MarkerFinder(tag_dictionary(), TAG_COUNT, BORDER_MODULES, windows=WINDOWS_FOR_TOUCHED)
        patches = PrintedPatches(
            drawn(columns, rows, pattern.spacing, TEXELS_PER_SQUARE, first), TEXELS_PER_SQUARE, self._corners
        )
        self._layout = board_corners.Layout(self._corners[corner_ids(columns, rows)], patches)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < 2 * MarkerFinder.LEAST_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no pattern")
        reading, seen = self._read_board(image)
        if reading is None or len(reading.markers) < LEAST_TAGS:
            return NotDetected(f"{seen} tags, {LEAST_TAGS} are needed that lie as on the board")
        if len(reading.markers) <= LEAST_AGREEING * seen:
            return NotDetected(f"{len(reading.markers)} of {seen} tags lie as on the board, more than half are needed")
        return board_corners.enough(
            self._corners,
            *board_corners.find_corners(image, reading, self._corners, self._clearance, LEAST_FREE, LEAST_ANGLE),
        )

    def _read_board(self, image: Image) -> tuple[board_corners.Reading | None, int]:
        """Return the tags that match the board, and the number of all tags.

        The search is repeated at a finer scale if many expected tags are missing.
        """
        found, seen = self._matching_tags(self._finder.find(image))
        if found is not None and found.share(*image.shape) >= 0.5:
            return found, seen
        finer = self._matching_tags(self._finder.find_small(image))
        return max((found, seen), finer, key=lambda each: len(each[0].markers) if each[0] else 0)

    def _matching_tags(self, tags: Markers) -> tuple[board_corners.Reading | None, int]:
        """Return the tags that match the board, and their number."""
        ids = tags.ids - self._first
        own = (ids >= 0) & (ids < self._count)
        lying = board_corners.readings([self._layout], Markers(ids[own], tags.corners[own]))
        return (lying[0] if lying else None), len(tags)
