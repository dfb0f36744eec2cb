"""Detection of grids without markers: chessboards, symmetric and asymmetric grids of circles.

OpenCV finds all corners or circles, or none; they are refined, and bad ones are removed.

Of chessboards OpenCV has two detectors. The older one takes a quarter of the time on photographs, and finds most of
what the newer one misses. Both find parts of larger boards too, the newer one with every second column left out, the
older one also charuco boards: what they find is compared with the print, inside and around it.

Where a circle is in the image is measured as the centre of its dark area, which blur does not move. The centre of that
area is not the image of the circle's centre once the board is tilted or the lens bends it: J. Heikkila, O. Silven, "A
four-step camera calibration procedure with implicit image correction", CVPR 1997. The difference is computed
with the board's map to the image (`calibration.robot.labelling.board_image`), which the centres give, and subtracted.

A grid without markers does not show its origin, so corner 0 is chosen by a rule. Candidates are the numberings of the
corners as a grid seen from the front (x along a row, y down a column, never mirrored). A chessboard has a black square
beyond corner 0, at the corner of the board; an asymmetric grid has its second row further along x than its first. Among
several, the most upright one is chosen: x closest to the right of the image.

So a board with an even number of squares in one direction and an odd number in the other keeps its ids at any
rotation, as an asymmetric grid does, which has an odd number of rows. With other chessboards, corner 0 changes when the
board is rotated by more than 90 degrees from upright (square boards with an odd number of squares: by 45), so a motion
should not rotate them as far.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.board_image import (
    TEXELS_PER_SQUARE,
    Prediction,
    PrintedPatches,
    fits_neighbours,
    predict,
    refine,
)
from calibration.robot.labelling.detection import CORNER_DECIMALS, Image, NotDetected, grey

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
        drawing = squares.astype(np.uint8).repeat(TEXELS_PER_SQUARE, 0).repeat(TEXELS_PER_SQUARE, 1)
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
        rough = next((grid for grid in self._find_grids(image) if self._looks_printed(image, grid)), None)
        if rough is None:
            return NotDetected("not all corners of the chessboard are found")
        pixels = self._sort_by_id(image, rough).reshape(-1, 2)
        predicted = predict(self._places, pixels, self._places)
        refined, found = refine(image, pixels, predicted.jacobians, REFINEMENT_RADIUS)
        found[found] = fits_neighbours(self._places[found], refined[found]) if found.sum() >= 4 else False
        if found.mean() < LEAST_SHARE:
            return NotDetected(f"{int((~found).sum())} of {len(found)} corners do not look like corners of a board")
        return CornerLabels(np.flatnonzero(found), np.round(refined[found], CORNER_DECIMALS))

    def _find_grids(self, image: Image) -> Iterator[Array]:
        """Find grids (rows, columns, 2) in some order along rows and columns; some are parts of other boards.

        Large images are first searched at half their size: in a quarter of the time, and the corners are then
        refined in the full image.
        """
        size = self._columns, self._rows
        halved = max(image.shape) > MIN_LARGE_SIDE
        older = (cv2.findChessboardCorners, OLDER_DETECTOR)
        newer = (cv2.findChessboardCornersSB, cv2.CALIB_CB_NORMALIZE_IMAGE)
        searches = ((2, older), (2, newer), (1, newer), (1, older)) if halved else ((1, older), (1, newer))
        for reduced, (search, flags) in searches:
            found, corners = search(_reduce_image(image, reduced), size, flags=flags)
            if found:
                yield _full_size_grid(corners, reduced, size)

    def _looks_printed(self, image: Image, grid: Array) -> bool:
        """Whether the image looks like the print around most corners of a grid, and does not go on beyond any side.

        The likeness changes its sign where the grid leaves out every second column of a larger board.
        """
        predicted = predict(self._places, grid.reshape(-1, 2), self._with_ring)
        likeness = self._patches.likeness(image, predicted.pixels, predicted.jacobians)
        likeness = likeness.reshape(self._rows + 2, self._columns + 2)
        likeness *= np.sign(np.nansum(likeness[1:-1, 1:-1]))  # the grid may begin at a white square
        # the part of a patch that the image's edge leaves may look like anything
        room = np.abs(predicted.jacobians).sum(axis=-1) / 2
        whole = ((predicted.pixels > room) & (predicted.pixels < np.array(image.shape[::-1]) - 1 - room)).all(axis=-1)
        alike = (likeness > MIN_LIKENESS) & whole.reshape(likeness.shape)
        beyond = (alike[0, 1:-1], alike[-1, 1:-1], alike[1:-1, 0], alike[1:-1, -1])
        return bool(alike[1:-1, 1:-1].mean() >= LEAST_SHARE and max(side.mean() for side in beyond) < 0.5)

    def _sort_by_id(self, image: Image, corners: Array) -> Array:
        """Sort the corners by their ids, (rows, columns, 2)."""
        ways = [way for way in grid_ways(corners) if seen_from_the_front(way)]
        black = [way for way in ways if _begins_black(image, way)]
        return max(black or ways, key=uprightness)


def _reduce_image(image: Image, reduced: int) -> Image:
    """Reduce the sides of an image by a factor."""
    return np.asarray(cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA), np.uint8)


def reduced_images(image: Image) -> Iterator[tuple[int, Image]]:
    """Yield the factors by which an image is searched, and the images: a large one first at half its size."""
    for reduced in (2, 1) if max(image.shape) > MIN_LARGE_SIDE else (1,):
        yield reduced, _reduce_image(image, reduced)


def _full_size_grid(found: Any, reduced: int, size: tuple[int, int]) -> Array:
    """Return what OpenCV found in a reduced image, in pixels of the image, (rows, columns, 2); size: columns, rows."""
    return ((np.array(found, float) + 0.5) * reduced - 0.5).reshape(size[1], size[0], 2)


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


LEAST_CIRCLES = 3
"""Minimum of circles along each side of a grid: fewer are found in clutter."""
LEAST_AREA = 12.0
"""Minimum area of a circle in the image, px."""
MAP_ROUNDS = 3
"""Number of times that the map and what follows from it are computed: the first has the centres of OpenCV."""
CONTOUR_POINTS = 32
"""Number of points of a circle's contour."""
MAX_DIAMETER_OFF = 1.3
"""Factor between the diameter in the images and the described one from which on it is another board."""


class CirclesDetector:
    """Corner detector of one grid of circles; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for a printed pattern.

        Raises:
            InputError: the grid is too small to be found, or its circles have no diameter.
        """
        if min(pattern.dimension) < LEAST_CIRCLES:
            raise InputError(
                f"pattern '{pattern.name}': found {pattern.dimension[0]} x {pattern.dimension[1]} circles, expected at "
                f"least {LEAST_CIRCLES} each way"
            )
        if pattern.kind == "asymmetric-circles" and pattern.dimension[1] % 2 == 0:
            raise InputError(
                f"pattern '{pattern.name}': found an asymmetric grid with {pattern.dimension[1]} rows, expected an odd "
                "number (4 x 11): others look the same turned, and OpenCV mistakes the order of their rows"
            )
        if pattern.inner_size is None:
            raise InputError(f"pattern '{pattern.name}': found no inner_size, expected the diameter of its circles (m)")
        self._dimension, self._asymmetric = pattern.dimension, pattern.kind == "asymmetric-circles"
        nearest = pattern.size * (np.sqrt(2) if self._asymmetric else 1.0)  # from a circle to the next: the unit here
        self._places: Array = pattern.pattern().corners[:, :2] / nearest
        self._radius = pattern.inner_size / nearest / 2
        self._gap = 1 - 2 * self._radius
        angle = 2 * np.pi * np.arange(CONTOUR_POINTS) / CONTOUR_POINTS
        contour = np.concatenate([np.zeros((1, 2)), self._radius * np.stack([np.cos(angle), np.sin(angle)], -1)])
        self._centres_and_contours = self._places[:, None] + contour

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect circles in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < MIN_PIXELS_PER_SQUARE * min(self._dimension):
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no such pattern")
        found = self._find_circles(image)
        numbered = None if found is None else self._sort_by_id(found)
        if numbered is None:
            return NotDetected("not all circles of the grid are found")
        centres = numbered.reshape(-1, 2)
        for _ in range(MAP_ROUNDS):
            known = np.isfinite(centres).all(-1)
            if known.mean() < LEAST_SHARE:
                return NotDetected("the circles are too near to the edge of the image")
            places, pixels = self._places[known], centres[known]
            around = predict(places, pixels, self._centres_and_contours.reshape(-1, 2))
            bias = self._centres_of_areas(around.pixels.reshape(len(centres), CONTOUR_POINTS + 1, 2))
            dark, diameters = self._dark_areas(image, predict(places, pixels, self._places), bias)
            centres = dark - bias
        seen = float(np.nanmedian(diameters)) if np.isfinite(diameters).any() else 0.0
        if not 1 / MAX_DIAMETER_OFF < seen < MAX_DIAMETER_OFF:
            return NotDetected(f"the circles are {seen:.2f} times as large as described")
        good = np.isfinite(centres).all(-1) & (abs(diameters / seen - 1) < MAX_DIAMETER_OFF - 1)
        good[good] = fits_neighbours(self._places[good], centres[good]) if good.sum() >= 4 else False
        if good.mean() < LEAST_SHARE:
            return NotDetected(f"{int((~good).sum())} of {len(good)} circles do not look like those of the grid")
        return CornerLabels(np.flatnonzero(good), np.round(centres[good], CORNER_DECIMALS))

    def _find_circles(self, image: Image) -> Array | None:
        """Find the circles (rows, columns, 2) in some order along rows and columns; a large image at half its size."""
        columns, rows = self._dimension
        layout = cv2.CALIB_CB_ASYMMETRIC_GRID if self._asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
        for reduced, smaller in reduced_images(image):
            finder = blob_finder(smaller.size / (columns * rows))
            for way in (0, cv2.CALIB_CB_CLUSTERING):
                found, centres = cv2.findCirclesGrid(smaller, (columns, rows), flags=layout | way, blobDetector=finder)
                if found:
                    return _full_size_grid(centres, reduced, (columns, rows))
        return None

    def _sort_by_id(self, found: Array) -> Array | None:
        """Sort the circles by their ids, (rows, columns, 2); None if they are seen from the back."""
        ways = [way for way in grid_ways(found) if seen_from_the_front(way)]
        if (
            self._asymmetric
        ):  # rows are no columns, and the second row begins between the first two circles of the first
            ways = [w for w in ways[:2] if ((w[1, 0] - w[0, 0]) * (w[0, 1] - w[0, 0])).sum() > 0]
        return max(ways, key=uprightness, default=None)

    def _centres_of_areas(self, centres_and_contours: Array) -> Array:
        """Return the centres (K, 2) of the areas within contours (K, 1 + C, 2), from their first points."""
        contour = centres_and_contours[:, 1:] - centres_and_contours[:, :1]
        after = np.roll(contour, -1, axis=1)
        twice = contour[..., 0] * after[..., 1] - contour[..., 1] * after[..., 0]
        bias: Array = ((contour + after) * twice[..., None]).sum(1) / (3 * twice.sum(1)[:, None])
        return bias

    def _dark_areas(self, image: Image, centres: Prediction, bias: Array) -> tuple[Array, Array]:
        """Return the centres (K, 2) of the circles' dark areas, px, and their diameters (K,) by the described one.

        White varies linearly around a circle, and ink takes a share of it. NaN beyond the image.
        """
        dark, diameters = np.full((len(bias), 2), np.nan), np.full(len(bias), np.nan)
        limit = self._radius + self._gap / 2
        for i, (about, J) in enumerate(zip(centres.pixels + bias, centres.jacobians, strict=True)):
            reach = limit * np.linalg.norm(J, axis=1)
            low, high = np.floor(about - reach), np.ceil(about + reach)
            if not (np.isfinite(reach).all() and (low >= 0).all() and (high < image.shape[::-1]).all()):
                continue
            (left, top), (right, bottom) = low.astype(int), high.astype(int) + 1
            y, x = np.mgrid[top:bottom, left:right]
            offset = np.stack([x, y], -1).reshape(-1, 2) - about
            from_centre = np.linalg.norm(offset @ np.linalg.inv(J).T, axis=-1)
            shade = image[top:bottom, left:right].reshape(-1).astype(float)
            plane = np.concatenate([np.ones((len(offset), 1)), offset], -1)
            paper = abs(from_centre - limit) < self._gap / 6
            white = plane @ np.linalg.lstsq(plane[paper], shade[paper], rcond=None)[0]
            ink = np.where(from_centre < limit, 1 - shade / np.maximum(white, 1.0), 0.0)
            black = ink[from_centre < self._radius / 2]
            if len(black) and black.mean() > 0 and ink.sum() > 0:
                dark[i] = about + ink @ offset / ink.sum()
                area = np.pi * self._radius**2 * abs(np.linalg.det(J))
                diameters[i] = np.sqrt(ink.sum() / black.mean() / area)
        return dark, diameters


def blob_finder(largest: float) -> "cv2.SimpleBlobDetector":
    """Return OpenCV's search of dark spots; `largest` is their maximum area (px)."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 20, 230, 10
    parameters.minArea, parameters.maxArea = LEAST_AREA, max(largest, 2 * LEAST_AREA)
    parameters.minDistBetweenBlobs = 4
    parameters.minConvexity = 0.8  # of small ones the pixels make corners
    return cv2.SimpleBlobDetector.create(parameters)
