"""The detector of corners for a pattern."""

from typing import Protocol

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.labelling.detection import Image, NotDetected


class CornerDetector(Protocol):
    """Finds the corners of one pattern in images.

    Made once and used for many images: what it finds in one does not depend on those before, nor on
    the process. Ids are those of `calibration.dataset.pattern.grid`: ``row * columns + column``, x
    along a row, y along a column, z away from the camera.
    """

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """The corners in an image (H, W) or (H, W, 3) of 8 bits, blue first; pixel (0, 0) is a centre.

        Raises:
            InputError: it is no such image.
        """
        ...


def corner_detector(pattern: PatternConfiguration) -> CornerDetector:
    """The detector for a pattern.

    Raises:
        InputError: no such board can be printed; the message says why.
    """
    # imported here, because OpenCV takes a while to load
    if pattern.kind == "charuco":
        from calibration.labelling.charuco import CharucoDetector

        return CharucoDetector(pattern)
    from calibration.labelling.chessboard import ChessboardDetector

    return ChessboardDetector(pattern)
