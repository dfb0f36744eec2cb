"""The charuco board: where its corners are, on the board and in an image."""

import cv2
import numpy as np

LEAST_SHARE = 0.4
"""Of the corners: an image that shows fewer is no detection."""


class Board:
    """A charuco board, as ATOM's configuration describes it."""

    def __init__(self, entry):
        columns, rows = entry["dimension"]["x"], entry["dimension"]["y"]
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, entry["dictionary"]))
        board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), entry["size"], entry["inner_size"], dictionary)
        self.corners = np.round(np.array(board.getChessboardCorners(), float), 6)
        """(K, 3) by id: row by row, from the corner of the board, m."""
        self._detector = cv2.aruco.CharucoDetector(board)

    def detect(self, image):
        """The ids and the pixels of the corners in an image; None if it shows too few."""
        pixels, ids, _, _ = self._detector.detectBoard(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        if ids is None or len(ids) < LEAST_SHARE * len(self.corners):
            return None
        return ids.ravel(), pixels.reshape(-1, 2).astype(float)
