"""Aprilgrids, the boards of tags that Kalibr prints: their print, and their detection in whole or partial views.

Tags of AprilTag's family 36h11 with a border of two modules, upright as AprilTag draws them, and a
black square at each crossing of gaps, so that four quarters of black and white meet in every corner of a tag. The
print consists of cells: a gap, the modules of a tag, a gap, and so on. Ids are Kalibr's
(`calibration.engine.dataset.pattern.tag_grid`).

Positions are from the top left corner of the print; x to the right, y down. The unit is about the mean distance of
corners in a row, so that detectors search as far as on a board of squares.

OpenCV reads the tags; the corners are found from them (`calibration.robot.labelling.board_corners`). OpenCV's own
corners of tags are about 3 px off, because the squares at the corners touch the tags.
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
from calibration.robot.labelling.board_corners import TEXELS_PER_SQUARE, Layout, Reading, enough, find_corners, readings
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.markers import WINDOWS_FOR_TOUCHED, MarkerFinder, Markers, turned_tags
from calibration.robot.labelling.printed_corners import PrintedPatches

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
        self._layout = Layout(self._corners[corner_ids(columns, rows)], patches)

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
        return enough(
            self._corners, *find_corners(image, reading, self._corners, self._clearance, LEAST_FREE, LEAST_ANGLE)
        )

    def _read_board(self, image: Image) -> tuple[Reading | None, int]:
        """Return the tags that match the board, and the number of all tags.

        The search is repeated at a finer scale if many expected tags are missing.
        """
        found, seen = self._matching_tags(self._finder.find(image))
        if found is not None and found.share(*image.shape) >= 0.5:
            return found, seen
        finer = self._matching_tags(self._finder.find_small(image))
        return max((found, seen), finer, key=lambda each: len(each[0].markers) if each[0] else 0)

    def _matching_tags(self, tags: Markers) -> tuple[Reading | None, int]:
        """Return the tags that match the board, and their number."""
        ids = tags.ids - self._first
        own = (ids >= 0) & (ids < self._count)
        lying = readings([self._layout], Markers(ids[own], tags.corners[own]))
        return (lying[0] if lying else None), len(tags)
