"""Detection of chessboards: OpenCV finds all corners or none; bad corners are removed afterwards.

OpenCV has two detectors. The older one takes a quarter of the time on photographs, and finds most of what the newer one
misses, but also parts of larger boards and of charuco boards: what it finds is compared with the print, inside and
around it. The newer one searches what is left.

A chessboard has no marker for its origin, so corner 0 is chosen by a rule. Candidates are the numberings of the
corners as a grid seen from the front (x along a row, y down a column, never mirrored) with a black square beyond
corner 0, at the corner of the board. Among several, the most upright one is chosen: x closest to the right of the
image.

So a board with an even number of squares in one direction and an odd number in the other keeps its ids at any
rotation. With others, corner 0 changes when the board is rotated by more than 90 degrees from upright (square boards
with an odd number of squares: by 45), so a motion should not rotate them as far.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.board_image import fits_neighbours, predict
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.printed_corners import PrintedPatches, refine

CORNER_DECIMALS = 4
"""Decimals of the corners' pixels."""
REFINEMENT_RADIUS = 0.4
"""Radius (squares) of the refinement around a corner; the next corners are at 1."""
LEAST_SHARE = 0.75
"""Minimum share of good corners for a detection; bad ones are removed, such as occluded ones."""
LEAST_CORNERS = 3
"""Minimum along each side of a board, required by OpenCV."""
MIN_LARGE_SIDE = 800
"""Longer side (px) from which on an image is first searched at half its size."""
MIN_LIKENESS = 0.75
"""Minimum correlation of the image around a corner with the print; at the border of a board it is below 0.6."""
TEXELS_PER_SQUARE = 32
"""Texels of the drawn board per side of a square."""
OLDER_DETECTOR = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
"""Flags of OpenCV's older detector; the last ends the search of an image without black squares."""
MIN_PIXELS_PER_SQUARE = 4
"""Minimum of an image's pixels per square of a board in it."""


class ChessboardDetector:
    """Corner detector of one chessboard; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for a printed pattern.

        Raises:
            InputError: the board has fewer corners than OpenCV requires.
        """
        if min(pattern.dimension) < LEAST_CORNERS:
            raise InputError(
                f"pattern '{pattern.name}': found {pattern.dimension[0]} x {pattern.dimension[1]} corners, expected at "
                f"least {LEAST_CORNERS} each way to find a chessboard"
            )
        self._columns, self._rows = pattern.dimension
        row, column = np.divmod(np.arange(self._columns * self._rows), self._columns)
        self._places = np.stack([column, row], -1).astype(float)
        y, x = np.mgrid[: self._rows + 2, : self._columns + 2]
        self._with_ring = np.stack([x.ravel(), y.ravel()], -1) - 1.0
        squares = np.indices((self._rows + 3, self._columns + 3)).sum(axis=0) % 2 * 255
        drawing = np.repeat(np.repeat(squares.astype(np.uint8), TEXELS_PER_SQUARE, axis=0), TEXELS_PER_SQUARE, axis=1)
        self._patches = PrintedPatches(drawing, TEXELS_PER_SQUARE, self._with_ring + 2)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if (
            max(image.shape) < MIN_PIXELS_PER_SQUARE * max(self._columns, self._rows)
            or min(image.shape) < MIN_PIXELS_PER_SQUARE * 3
        ):
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no such pattern")
        rough = self._find_by_older_detector(image, 2 if max(image.shape) > MIN_LARGE_SIDE else 1)
        if rough is None and (rough := self._find_corners(image)) is None and max(image.shape) > MIN_LARGE_SIDE:
            rough = self._find_by_older_detector(image, 1)
        if rough is None:
            return NotDetected("not all corners of the chessboard are found")
        pixels = self._sort_by_id(image, rough).reshape(-1, 2)
        predicted = predict(self._places, pixels, self._places)
        refined, found = refine(image, pixels, predicted.jacobians, REFINEMENT_RADIUS)
        found[found] = fits_neighbours(self._places[found], refined[found]) if found.sum() >= 4 else False
        if found.mean() < LEAST_SHARE:
            return NotDetected(f"{int((~found).sum())} of {len(found)} corners do not look like corners of a board")
        return CornerLabels(np.flatnonzero(found), np.round(refined[found], CORNER_DECIMALS))

    def _find_corners(self, image: Image) -> Array | None:
        """Find the corners (rows, columns, 2) in some order along rows and columns; None if there are none.

        Large images are first searched at half their size: in a quarter of the time, and the corners are then
        refined in the full image.
        """
        sizes = (2, 1) if max(image.shape) > MIN_LARGE_SIDE else (1,)
        for reduced in sizes:
            smaller = cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA)
            found, corners = cv2.findChessboardCornersSB(
                smaller, (self._columns, self._rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE
            )
            if found:
                pixels = (np.array(corners, float) + 0.5) * reduced - 0.5
                return pixels.reshape(self._rows, self._columns, 2)
        return None

    def _find_by_older_detector(self, image: Image, reduced: int) -> Array | None:
        """Find the corners like `_find_corners`; None also for a charuco board, or a part of a larger board."""
        smaller = cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA)
        found, corners = cv2.findChessboardCorners(smaller, (self._columns, self._rows), flags=OLDER_DETECTOR)
        if not found:
            return None
        grid = ((np.array(corners, float) + 0.5) * reduced - 0.5).reshape(self._rows, self._columns, 2)
        return grid if self._looks_printed(image, grid) else None

    def _looks_printed(self, image: Image, grid: Array) -> bool:
        """Whether the image looks like the print around most corners of a grid, and does not go on beyond any side."""
        predicted = predict(self._places, grid.reshape(-1, 2), self._with_ring)
        likeness = np.abs(self._patches.likeness(image, predicted.pixels, predicted.jacobians))
        # the part of a patch that the image's edge leaves may look like anything
        room = np.abs(predicted.jacobians).sum(axis=-1) / 2
        whole = ((predicted.pixels > room) & (predicted.pixels < np.array(image.shape[::-1]) - 1 - room)).all(axis=-1)
        alike = ((likeness > MIN_LIKENESS) & whole).reshape(self._rows + 2, self._columns + 2)
        beyond = (alike[0, 1:-1], alike[-1, 1:-1], alike[1:-1, 0], alike[1:-1, -1])
        return bool(alike[1:-1, 1:-1].mean() >= LEAST_SHARE and max(side.mean() for side in beyond) < 0.5)

    def _sort_by_id(self, image: Image, corners: Array) -> Array:
        """Sort the corners by their ids, (rows, columns, 2)."""
        ways = [way for way in grid_ways(corners) if seen_from_the_front(way)]
        black = [way for way in ways if _begins_black(image, way)]
        return max(black or ways, key=uprightness)


def grid_ways(corners: Array) -> Iterator[Array]:
    """Iterate over all numberings of a grid along its rows and columns."""
    square = corners.shape[0] == corners.shape[1]
    for grid in (corners, corners.swapaxes(0, 1)) if square else (corners,):
        yield from (grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1])


def grid_axes(grid: Array) -> tuple[Array, Array]:
    """Return the mean steps along x and along y, px."""
    return np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))


def seen_from_the_front(grid: Array) -> bool:
    """Whether x, y and the direction of view are right-handed."""
    x, y = grid_axes(grid)
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def uprightness(grid: Array) -> float:
    """Return the cosine of the angle between x and the right of the image."""
    x, _ = grid_axes(grid)
    return float(x[0] / np.linalg.norm(x))


def _begins_black(image: Image, grid: Array) -> bool:
    """Whether the square beyond corner 0 is black: it has the colour of the one between corners 0 and 0 + (1, 1)."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = np.moveaxis(np.round(centres).astype(int), -1, 0)
    shades = image[y.clip(0, image.shape[0] - 1), x.clip(0, image.shape[1] - 1)].astype(float)
    alike = np.indices(shades.shape).sum(axis=0) % 2 == 0
    return bool(shades[alike].mean() < shades[~alike].mean())
