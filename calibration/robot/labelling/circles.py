"""Detection of grids of circles, symmetric and asymmetric: OpenCV finds all circles or none, their centres are refined.

Where a circle is in the image is measured as the centre of its dark area, which blur does not move. The centre of that
area is not the image of the circle's centre once the board is tilted or the lens bends it: J. Heikkila, O. Silven, "A
four-step camera calibration procedure with implicit image correction", CVPR 1997. The difference is computed
with the board's map to the image (`calibration.robot.labelling.board_image`), which the centres give, and subtracted.

A grid of circles has no marker for its origin. Candidates are the numberings that are seen from the front and, of an
asymmetric grid, have its second row further along x than its first; the most upright one is chosen. So an asymmetric
grid, which has an odd number of rows, keeps its ids at any rotation.
"""

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.board_image import Prediction, fits_neighbours, predict
from calibration.robot.labelling.chessboard import (
    CORNER_DECIMALS,
    LEAST_SHARE,
    MIN_LARGE_SIDE,
    MIN_PIXELS_PER_SQUARE,
    grid_ways,
    seen_from_the_front,
    uprightness,
)
from calibration.robot.labelling.detection import Image, NotDetected, grey

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
        for reduced in (2, 1) if max(image.shape) > MIN_LARGE_SIDE else (1,):
            smaller = cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA)
            finder = blob_finder(smaller.size / (columns * rows))
            for way in (0, cv2.CALIB_CB_CLUSTERING):
                found, centres = cv2.findCirclesGrid(smaller, (columns, rows), flags=layout | way, blobDetector=finder)
                if found:
                    return ((np.array(centres, float) + 0.5) * reduced - 0.5).reshape(rows, columns, 2)
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
