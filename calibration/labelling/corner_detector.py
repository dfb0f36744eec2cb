"""Corner detectors by the kind of the pattern."""

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
"""Constructors of detectors, by the kind of the pattern."""


def corner_detector(pattern: PatternConfiguration) -> CornerDetector:
    """Create the corner detector of a pattern.

    Raises:
        InputError: such a board cannot be printed; the message has the reason.
    """
    return DETECTORS[pattern.kind](pattern)
