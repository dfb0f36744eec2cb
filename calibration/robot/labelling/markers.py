"""ArUco markers and AprilTag's tags in an image, and the detector of single ones: one, or several in a plane.

OpenCV reads them; their sides are then fitted to the edges of the image, and meet in their corners: blur moves no
straight edge, but it rounds a corner. A side may be bent by the lens, so the fit is a parabola.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.detection import CORNER_DECIMALS, Image, NotDetected, grey

ENLARGEMENT_FACTOR = 2
"""Factor by which an image is enlarged for small markers."""
MAX_ENLARGED_PIXELS = 20_000_000
"""Limit of the pixels that are enlarged: in larger images the smallest marker has dozens of pixels anyway."""
LEAST_PERIMETER = 0.03
"""Minimum perimeter of a marker, relative to the longer side of the image (OpenCV's default)."""
APRILTAG_PREFIX = "DICT_APRILTAG_"
"""Begin of the names of OpenCV's dictionaries of AprilTag's families."""
FIRST_36H11 = 0xD5D628584
"""Code of the first tag of AprilTag's family 36h11, upright: 36 modules row by row from the highest bit; 1 is white."""
Windows = tuple[tuple[int, int], tuple[int, int]]
"""The least and the largest window of a threshold (px, in steps of 10): in an image, and in an enlarged one."""
WINDOWS_FOR_APART: Windows = (9, 9), (7, 17)
"""For markers with white around them."""
WINDOWS_FOR_TOUCHED: Windows = (3, 13), (5, 15)
"""For tags whose corners touch black squares, which larger windows join: in 14 rendered boards of 36 tags (640 x 480)
an image gives 297 tags (21 with `WINDOWS_FOR_APART`), an enlarged one 390 (342)."""
Box = tuple[int, int, int, int]
"""Left, top, right and bottom of a part of an image (px); right and bottom are outside."""


@dataclass(frozen=True, eq=False)
class Markers:
    """Detected markers, sorted by id, each id once."""

    ids: IntArray
    """(M,)."""
    corners: Array
    """(M, 4, 2): px; clockwise from the marker's own top left."""

    def __len__(self) -> int:
        return len(self.ids)


class MarkerFinder:
    """Detector of `count` consecutive markers of a dictionary, which it numbers from 0."""

    LEAST_SIDE = 8
    """Minimum side of a marker (px)."""

    def __init__(
        self,
        dictionary: "cv2.aruco.Dictionary",
        count: int,
        border: int = 1,
        first: int = 0,
        correction: float = 0.9,
        windows: Windows = WINDOWS_FOR_APART,
    ) -> None:
        """Create the detector.

        Args:
            dictionary: the markers' dictionary.
            count: number of markers.
            border: width of the black border around a marker's bits, in modules.
            first: the id in the dictionary of marker 0.
            correction: share of the wrong bits of a code that are corrected, of those that can be.
            windows: of the adaptive thresholds.
        """
        self._plain, self._fine = (
            cv2.aruco.ArucoDetector(dictionary, _detector_parameters(each, border, correction)) for each in windows
        )
        self._first, self._count = first, count

    def find(self, image: Image) -> Markers:
        """Detect the markers in a grey image; small ones are missed."""
        return self._as_markers(self._plain.detectMarkers(image), 1)

    def find_small(self, image: Image, box: Box | None = None) -> Markers:
        """Detect also small markers, down to about 9 pixels, in the enlarged image or a part of it; slower."""
        left, top, right, bottom = box or (0, 0, image.shape[1], image.shape[0])
        part = image[top:bottom, left:right]
        scale = ENLARGEMENT_FACTOR if part.size <= MAX_ENLARGED_PIXELS else 1
        larger = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        # relative to the longer side of the part: the smallest marker is that of the whole image
        parameters = self._fine.getDetectorParameters()
        parameters.minMarkerPerimeterRate = LEAST_PERIMETER * max(image.shape) / max(right - left, bottom - top)
        self._fine.setDetectorParameters(parameters)
        return self._as_markers(self._fine.detectMarkers(larger), scale, (left, top))

    def _as_markers(self, detected: Any, scale: int, begin: tuple[int, int] = (0, 0)) -> Markers:
        corners, ids, _ = detected
        if ids is None or not len(ids):
            return Markers(np.zeros(0, np.int64), np.zeros((0, 4, 2)))
        found = np.array(ids, np.int64).ravel() - self._first
        pixels = (np.array(corners, float).reshape(-1, 4, 2) + 0.5) / scale - 0.5 + np.array(begin)
        known = (found >= 0) & (found < self._count)
        found, first = np.unique(found[known], return_index=True)
        return Markers(found, pixels[known][first])


def printed_dictionary(pattern: PatternConfiguration) -> "cv2.aruco.Dictionary":
    """Return OpenCV's dictionary of a pattern's markers or tags.

    Raises:
        InputError: there is no such dictionary, or it lacks one of the pattern's tags.
    """
    name = pattern.dictionary or ""
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or number is None:
        expected = "expected one of OpenCV's, such as DICT_5X5_100 or DICT_APRILTAG_36h11"
        raise InputError(f"pattern '{pattern.name}': dictionary: found '{name}', {expected}")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    highest, last = max((tag.id for tag in pattern.tags), default=0), len(dictionary.bytesList) - 1
    if highest > last:
        raise InputError(f"pattern '{pattern.name}': found tag {highest}, expected ids of {name}: 0 to {last}")
    return dictionary


@lru_cache(maxsize=1)
def turned_tags() -> int:
    """Return the quarter turns to the left from OpenCV's drawing of a tag of AprilTag's to AprilTag's own.

    2 with OpenCV 4, which draws them upside down; OpenCV 5 has mended that (github.com/opencv/opencv/pull/28823).
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    drawn = np.asarray(cv2.aruco.generateImageMarker(dictionary, 0, 8))[1:-1, 1:-1] > 127
    upright = np.array([FIRST_36H11 >> i & 1 for i in range(35, -1, -1)], bool).reshape(6, 6)
    return next(turns for turns in range(4) if (np.rot90(drawn, turns) == upright).all())


def turns_of(pattern: PatternConfiguration) -> int:
    """Return the quarter turns to the left from OpenCV's drawing of a pattern's tags to how they are upright."""
    return turned_tags() if (pattern.dictionary or "").startswith(APRILTAG_PREFIX) else 0


def _detector_parameters(windows: tuple[int, int], border: int, correction: float) -> "cv2.aruco.DetectorParameters":
    """Return the detector parameters with the best measured trade-off between found markers and time.

    A low threshold constant finds dark boards; much lower ones trace the noise of the image.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = 4
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows
    parameters.adaptiveThreshWinSizeStep = 10
    parameters.errorCorrectionRate = correction
    parameters.markerBorderBits = border
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return parameters


MAX_CORRECTED = 0.3
"""Limit of the share of a code's wrong bits that are corrected, of those that can be: a single tag has no neighbours
that confirm it."""
MIN_SIDE = 16.0
"""Minimum height of a tag above its longest side, px."""
SIDE_POSITIONS = np.linspace(0.08, 0.92, 43)
"""Positions along a side where its edge is looked for; the rest is rounded by blur."""
MAX_SEARCH_DEPTH, MIN_SEARCH_DEPTH, ENOUGH_PX = 0.45, 0.2, 2.5
"""How far an edge is looked for to each side: in modules as seen across it, and what is enough for any blur (px).

A tag's black border is one module wide, and its white margin is often cut: in public images with a margin of 0.35
modules of 12 px, corners by 0.45 modules were off by 1.3 px, and 27 of 42 tags had no clear edges.
"""
FIT_ROUNDS = 3
"""Number of times that the sides are fitted, each from the corners before."""
MIN_EDGES = 0.6
"""Minimum share of the positions where an edge is found."""


class TagListDetector:
    """Corner detector of tags at known places; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for printed tags.

        Raises:
            InputError: their dictionary is unknown, or has no such tag.
        """
        dictionary = printed_dictionary(pattern)
        self._finder = MarkerFinder(dictionary, len(dictionary.bytesList), correction=MAX_CORRECTED)
        self._modules = dictionary.markerSize + 2
        self._ids = [tag.id for tag in pattern.tags]
        self._turns = turns_of(pattern)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect the corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < MIN_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no tag")
        seen = self._finder.find(image)
        if self._count_missing(seen):
            seen = max(seen, self._finder.find_small(image), key=lambda each: -self._count_missing(each))
        ids: list[IntArray] = []
        pixels: list[Array] = []
        for place, own in enumerate(self._ids):
            for corners in seen.corners[seen.ids == own]:
                refined = refined_corners(image, np.roll(corners, -self._turns, axis=0), self._modules)
                if refined is not None:
                    ids.append(4 * place + np.arange(4))
                    pixels.append(refined)
        if not ids:
            return NotDetected(f"none of its {len(self._ids)} tags, of {len(seen)} of the dictionary in the image")
        return CornerLabels(np.concatenate(ids), np.concatenate(pixels).round(CORNER_DECIMALS))

    def _count_missing(self, seen: Markers) -> int:
        return len(set(self._ids) - set(seen.ids.tolist()))


def refined_corners(image: Image, corners: Array, modules: int) -> Array | None:
    """Return the corners (4, 2) in which the sides of a tag meet, px; None if it is too small or its edges are unclear.

    Args:
        image: (H, W), grey.
        corners: (4, 2), px, roughly, around the tag in the sense of a clock.
        modules: number of its modules along a side.
    """
    for _ in range(FIT_ROUNDS):
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(sides, axis=-1)
        x, y = (corners - np.roll(corners, 2, axis=0))[:2].T  # the diagonals
        height = abs(x[0] * y[1] - x[1] * y[0]) / 2 / lengths.max()
        if height < MIN_SIDE:
            return None
        along = sides / lengths[:, None]
        outwards = np.stack([along[:, 1], -along[:, 0]], -1)
        fits = []
        for corner, side, out, length in zip(corners, sides, outwards, lengths, strict=True):
            module = height / modules
            reach = min(MAX_SEARCH_DEPTH * module, max(ENOUGH_PX, MIN_SEARCH_DEPTH * module))
            edge = _edge_offsets(image, corner + SIDE_POSITIONS[:, None] * side, out, reach)
            found = np.isfinite(edge)
            if found.mean() < MIN_EDGES:
                return None
            fits.append(np.polynomial.polynomial.polyfit(SIDE_POSITIONS[found], edge[found], 2) / [1, length, length])
        bends = np.array(fits)  # offset outwards, slope and half the curvature, by the position in px
        before = np.roll(np.arange(4), 1)
        at_end = bends[before] @ [1, 0, 0] + (bends[before, 1] + bends[before, 2]) * lengths[before]
        slope_at_end = bends[before, 1] + 2 * bends[before, 2]
        # the tangents of two sides at their corner: normals and offsets
        n = np.stack([outwards - bends[:, 1:2] * along, outwards[before] - slope_at_end[:, None] * along[before]], 1)
        corners = corners + np.linalg.solve(n, np.stack([bends[:, 0], at_end], -1)[..., None])[..., 0]
    return corners


def _edge_offsets(image: Image, places: Array, out: Array, reach: float) -> Array:
    """Return how far outwards (N,) of places (N, 2) black becomes white, px; NaN where it does not."""
    steps = np.linspace(-reach, reach, 2 * int(np.ceil(2 * reach)) + 3)
    x, y = np.moveaxis(places[:, None] + steps[:, None] * out, -1, 0).astype(np.float32)
    shades = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    # light may vary along a side, by which a common white would slant its edge
    line = np.polynomial.polynomial.polyvander(SIDE_POSITIONS, 1)
    black, white = (line @ np.linalg.lstsq(line, shades[:, end], rcond=None)[0] for end in (0, -1))
    share = (shades - black[:, None]) / np.maximum(white - black, 1.0)[:, None]
    # the width of what is dark, as its edge is at half of it: the sum over the profile takes all of its samples
    dark = np.clip(1 - share, -0.25, 1.25)
    width = (dark.sum(1) - dark[:, [0, -1]].sum(1) / 2) * (steps[1] - steps[0])
    clear: np.ndarray = (abs(share[:, 0]) < 0.25) & (abs(share[:, -1] - 1) < 0.25)
    return np.where(clear, width - reach, np.nan)
