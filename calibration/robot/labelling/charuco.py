"""Detection of charuco boards, in whole or partial views.

OpenCV reads the markers; the corners are found from them (`calibration.robot.labelling.board_corners`).

Ids are ATOM's: ``row * columns + column`` in the pattern's frame, x along a row, y along a column, z
away from the camera, as in OpenCV's board since 4.6; labels by ATOM with OpenCV 4.6 have the same ids
(tested on real data). Their pixels are half a pixel larger in x and y: that version has its
origin at the corner of the top-left pixel; here the pixel's centre is (0, 0).
"""

import cv2
import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.board_corners import (
    Reading,
    board_layouts,
    enough,
    find_corners,
    neighbours_in_place,
    readings,
)
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.markers import MarkerFinder, Markers

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
        self._layouts = board_layouts(columns + 1, rows + 1, marker, dictionary, self._corners, first)

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
        candidates = [find_corners(image, reading, self._corners, self._clearance) for reading in found]
        candidates.sort(key=lambda candidate: -len(candidate[0]))
        ids, pixels = candidates[0]
        labels = enough(self._corners, ids, pixels)
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
        return neighbours_in_place(self._layouts, Markers(own[known], markers.corners[known]))

    def _read_markers(self, image: Image) -> list[Reading]:
        """Read the markers by the likeliest layouts; repeated at a finer scale if many expected ones are missing."""
        found = readings(self._layouts, self._finder.find(image))
        if found and found[0].share(*image.shape) >= 0.5:
            return found
        finer = readings(self._layouts, self._finder.find_small(image, found[0].box(*image.shape) if found else None))
        return max(found, finer, key=lambda r: len(r[0].markers) if r else 0)


def _opencv_dictionary(pattern: PatternConfiguration) -> "cv2.aruco.Dictionary":
    name = pattern.dictionary or ""
    known = sorted(key for key in dir(cv2.aruco) if key.startswith("DICT_") and "X" in key)
    if name not in known:
        raise InputError(
            f"pattern '{pattern.name}': found dictionary '{name}', expected one of OpenCV's: {', '.join(known)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
