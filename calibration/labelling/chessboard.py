"""The corners of chessboards: OpenCV finds all of them or none, and those that are no good are left out.

A chessboard has no marker that says where it begins, so corner 0 is chosen by a rule. Of the ways to
number the corners as a grid that is seen from the front (x along a row, y down a column, never
mirrored), those count that have a black square beyond corner 0, at the corner of the board. Where
several are left, the one that stands most upright does: x nearest to the right of the image.

So a board with an even number of squares one way and an odd number the other way keeps its ids however
it is turned. Others jump when they are turned by more than 90 degrees from upright (square boards with
an odd number of squares: by 45), so a motion should not turn them as far.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.errors import InputError
from calibration.geometry.types import Array
from calibration.labelling.board_image import fits_neighbours, predict
from calibration.labelling.detection import Image, NotDetected, grey
from calibration.labelling.printed_corners import refine

DECIMALS = 4
"""Of the corners' pixels."""
CLEARANCE = 0.4
"""How far around a corner refinement looks (squares); the next corners are at 1."""
LEAST_SHARE = 0.75
"""A smaller share of corners that look like corners of a board is none; what the others hide is left out."""
LEAST_CORNERS = 3
"""Along each side of a board, for OpenCV to find it."""
LARGE = 800
"""The longer side of an image that is searched at half its size first (px)."""
MARGIN = 4
"""An image has at least so many pixels for each square of a board in it."""


class ChessboardDetector:
    """Finds the corners of one chessboard; see `calibration.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """For a pattern as it is printed.

        Raises:
            InputError: OpenCV finds no board with so few corners.
        """
        if min(pattern.dimension) < LEAST_CORNERS:
            raise InputError(
                f"pattern '{pattern.name}': found {pattern.dimension[0]} x {pattern.dimension[1]} corners, expected at "
                f"least {LEAST_CORNERS} each way to find a chessboard"
            )
        self._columns, self._rows = pattern.dimension
        row, column = np.divmod(np.arange(self._columns * self._rows), self._columns)
        self._places = np.stack([column, row], -1).astype(float)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """The corners in an image (H, W) or (H, W, 3) of 8 bits, blue first; pixel (0, 0) is a centre.

        Raises:
            InputError: it is no such image.
        """
        image = grey(image)
        if max(image.shape) < MARGIN * max(self._columns, self._rows) or min(image.shape) < MARGIN * 3:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no such pattern")
        rough = self._find(image)
        if rough is None:
            return NotDetected("not all corners of the chessboard are found")
        pixels = self._numbered(image, rough).reshape(-1, 2)
        predicted = predict(self._places, pixels, self._places)
        refined, found = refine(image, pixels, predicted.jacobians, CLEARANCE)
        found[found] = fits_neighbours(self._places[found], refined[found]) if found.sum() >= 4 else False
        if found.mean() < LEAST_SHARE:
            return NotDetected(f"{int((~found).sum())} of {len(found)} corners do not look like corners of a board")
        return CornerLabels(np.flatnonzero(found), np.round(refined[found], DECIMALS))

    def _find(self, image: Image) -> Array | None:
        """The corners (rows, columns, 2) in some order along rows and columns; None where there are none.

        Large images are searched at half their size first: a quarter of the time, and the corners are
        refined in the whole image afterwards. OpenCV's older detector is faster where it finds a
        board, takes a second where there is none, and sees boards in charuco boards.
        """
        sizes = (2, 1) if max(image.shape) > LARGE else (1,)
        for reduced in sizes:
            smaller = cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA)
            found, corners = cv2.findChessboardCornersSB(
                smaller, (self._columns, self._rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE
            )
            if found:
                pixels = (np.array(corners, float) + 0.5) * reduced - 0.5
                return pixels.reshape(self._rows, self._columns, 2)
        return None

    def _numbered(self, image: Image, corners: Array) -> Array:
        """The corners in the order of their ids, (rows, columns, 2)."""
        ways = [way for way in _ways(corners) if _seen_from_the_front(way)]
        black = [way for way in ways if _begins_black(image, way)]
        return max(black or ways, key=_upright)


def _ways(corners: Array) -> Iterator[Array]:
    """All ways to number a grid along its rows and columns."""
    square = corners.shape[0] == corners.shape[1]
    for grid in (corners, corners.swapaxes(0, 1)) if square else (corners,):
        yield from (grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1])


def _axes(grid: Array) -> tuple[Array, Array]:
    """The mean steps along x and along y, px."""
    return np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))


def _seen_from_the_front(grid: Array) -> bool:
    x, y = _axes(grid)
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def _upright(grid: Array) -> float:
    """The cosine of the angle from the right of the image to x."""
    x, _ = _axes(grid)
    return float(x[0] / np.linalg.norm(x))


def _begins_black(image: Image, grid: Array) -> bool:
    """Whether the square beyond corner 0 is black: it is as the one between corners 0 and 0 + (1, 1)."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = np.moveaxis(np.round(centres).astype(int), -1, 0)
    shades = image[y.clip(0, image.shape[0] - 1), x.clip(0, image.shape[1] - 1)].astype(float)
    alike = np.indices(shades.shape).sum(axis=0) % 2 == 0
    return bool(shades[alike].mean() < shades[~alike].mean())
