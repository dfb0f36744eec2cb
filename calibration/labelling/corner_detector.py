"""The detector of corners for a pattern, by its kind."""

from calibration.dataset.configuration import PatternConfiguration
from calibration.labelling.charuco import CharucoDetector
from calibration.labelling.chessboard import ChessboardDetector
from calibration.labelling.detection import CornerDetector


def corner_detector(pattern: PatternConfiguration) -> CornerDetector:
    """The detector for a pattern.

    Raises:
        InputError: no such board can be printed; the message says why.
    """
    return CharucoDetector(pattern) if pattern.kind == "charuco" else ChessboardDetector(pattern)
