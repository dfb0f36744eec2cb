"""Detection of ArUco markers in an image."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.robot.labelling.detection import Image

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
