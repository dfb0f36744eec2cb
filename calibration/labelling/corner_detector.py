"""The detector of corners for a pattern, by its kind."""

from collections.abc import Callable, Mapping

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.pattern import PatternKind
from calibration.labelling.aprilgrid import AprilgridDetector
from calibration.labelling.charuco import CharucoDetector
from calibration.labelling.chessboard import ChessboardDetector
from calibration.labelling.detection import CornerDetector

DETECTORS: Mapping[PatternKind, Callable[[PatternConfiguration], CornerDetector]] = {
    "charuco": CharucoDetector,
    "chessboard": ChessboardDetector,
    "aprilgrid": AprilgridDetector,
}
"""By the kind of a pattern."""


def corner_detector(pattern: PatternConfiguration) -> CornerDetector:
    """The detector for a pattern.

    Raises:
        InputError: no such board can be printed; the message says why.
    """
    return DETECTORS[pattern.kind](pattern)
