"""Print of an aprilgrid, as Kalibr prints it.

Tags of AprilTag's family 36h11 with a border of two modules, upright as AprilTag draws them, and a
black square at each crossing of gaps, so that four quarters of black and white meet in every corner of a tag. The
print consists of cells: a gap, the modules of a tag, a gap, and so on.

Positions are from the top left corner of the print; x to the right, y down. The unit is about the mean distance of
corners in a row, so that detectors search as far as on a board of squares.
"""

from functools import lru_cache

import cv2
import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.configuration import APRILGRID_TAGS
from calibration.engine.dataset.pattern import tag_grid, tag_lines, tag_outline
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.markers import turned_tags

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
