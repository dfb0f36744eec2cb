"""What detectors take and answer, whatever the sensor; and the detector of corners for a pattern."""

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset.model import CornerLabels
from calibration.errors import InputError

Image = NDArray[np.uint8]
"""Grey (H, W) or colour (H, W, 3), blue first, as OpenCV has them."""

DepthImage = NDArray[np.uint16]
"""(H, W): the depth along the optical axis as in `calibration.dataset.depth_image`."""


@dataclass(frozen=True)
class NotDetected:
    """A sensor does not see a pattern."""

    reason: str
    """Why, in a few words for a user, such as "7 markers, more than 8 are needed"."""


def grey(image: NDArray[Any]) -> Image:
    """The image in grey, (H, W).

    Raises:
        InputError: it is neither grey nor colour, or not of 8 bits.
    """
    colour = image.ndim == 3 and image.shape[2] == 3
    if image.dtype != np.uint8 or not (image.ndim == 2 or colour):
        raise InputError(
            f"found an image of {image.dtype} {image.shape}, expected 8 bits a channel, (height, width) or "
            "(height, width, 3)"
        )
    if not colour or not image.size:
        return image.reshape(image.shape[:2]) if not colour else image[:, :, 0]
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


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
