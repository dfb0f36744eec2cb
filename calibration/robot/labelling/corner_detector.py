"""Corner detectors by the kind of the pattern."""

from collections.abc import Callable, Mapping

import numpy as np

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import PatternKind
from calibration.robot.labelling.detection import CornerDetector, Image, NotDetected, grey
from calibration.robot.labelling.marked_boards import AprilgridDetector, CharucoDetector
from calibration.robot.labelling.markers import TagListDetector
from calibration.robot.labelling.unmarked_grids import ChessboardDetector, CirclesDetector

DETECTOR_OF_KIND: Mapping[PatternKind, Callable[[PatternConfiguration], CornerDetector]] = {
    "charuco": CharucoDetector,
    "chessboard": ChessboardDetector,
    "aprilgrid": AprilgridDetector,
    "circles": CirclesDetector,
    "asymmetric-circles": CirclesDetector,
    "tags": TagListDetector,
}
"""Constructors of detectors, by the kind of the pattern."""


def corner_detector(pattern: PatternConfiguration) -> CornerDetector:
    """Create the corner detector of a pattern.

    Raises:
        InputError: such a board cannot be printed; the message has the reason.
    """
    detector = DETECTOR_OF_KIND[pattern.kind](pattern)
    return InvertedBoardDetector(detector) if pattern.inverted else detector


class InvertedBoardDetector:
    """Corner detector of a board with black and white exchanged, by that of the board."""

    def __init__(self, detector: CornerDetector) -> None:
        """Keep the detector of the board as it usually is."""
        self._detector = detector

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        return self._detector.detect(np.bitwise_not(grey(image)))
