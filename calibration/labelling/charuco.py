"""The corners of charuco boards, from whole or partial views.

OpenCV reads the markers; they lead to the corners (`calibration.labelling.board_corners`).

Ids are ATOM's: ``row * columns + column`` in the pattern's frame, x along a row, y along a column, z
away from the camera, as OpenCV's board has them since 4.6; labels that ATOM made with OpenCV 4.6 have
the same ids (held by a test on real data). They are half a pixel to the right and below ours: that
version took the corner of the top-left pixel as the origin; here its centre is (0, 0).
"""

import cv2
import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.errors import InputError
from calibration.labelling.board_corners import enough, find_corners
from calibration.labelling.detection import Image, NotDetected, grey
from calibration.labelling.layouts import Reading, board_layouts, readings
from calibration.labelling.markers import MarkerFinder

LEAST_MARKERS = 8
"""More markers than that, and enough corners, make a detection (ATOM's rule).

A board with fewer than 33 markers needs more than a quarter of them.
"""


class CharucoDetector:
    """Finds the corners of one charuco board; see `calibration.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """For a pattern as it is printed; whether in OpenCV's modern or legacy layout, each image tells.

        Raises:
            InputError: no such board can be printed.
        """
        dictionary = _dictionary(pattern)
        columns, rows = pattern.dimension
        row, column = np.divmod(np.arange(columns * rows), columns)
        self._corners = np.stack([column + 1.0, row + 1.0], -1)
        markers = (columns + 1) * (rows + 1) // 2
        available = len(dictionary.bytesList)
        if markers > available:
            raise InputError(
                f"pattern '{pattern.name}': a charuco board of {columns} x {rows} corners has {markers} markers, "
                f"{pattern.dictionary} has {available}: name a larger dictionary"
            )
        if pattern.inner_size is None:
            raise InputError(f"pattern '{pattern.name}': a charuco board needs inner_size, the side of its markers")
        marker = pattern.inner_size / pattern.size
        self._clearance = (1 - marker) / 2
        self._needed = min(LEAST_MARKERS, markers // 4)
        self._finder = MarkerFinder(dictionary, markers)
        self._layouts = board_layouts(columns + 1, rows + 1, marker, dictionary, self._corners)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """The corners in an image (H, W) or (H, W, 3) of 8 bits, blue first; pixel (0, 0) is a centre.

        Raises:
            InputError: it is no such image.
        """
        image = grey(image)
        if min(image.shape) < 2 * MarkerFinder.LEAST_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no pattern")
        found = self._read(image)
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

    def _read(self, image: Image) -> list[Reading]:
        """The markers as the likeliest layouts have them; looked for again, finer, where many should be and are not."""
        found = readings(self._layouts, self._finder.find(image))
        if found and found[0].share(*image.shape) >= 0.5:
            return found
        finer = readings(self._layouts, self._finder.find_small(image))
        return max(found, finer, key=lambda r: len(r[0].markers) if r else 0)


def _dictionary(pattern: PatternConfiguration) -> "cv2.aruco.Dictionary":
    name = pattern.dictionary or ""
    known = sorted(key for key in dir(cv2.aruco) if key.startswith("DICT_") and "X" in key)
    if name not in known:
        raise InputError(
            f"pattern '{pattern.name}': found dictionary '{name}', expected one of OpenCV's: {', '.join(known)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
