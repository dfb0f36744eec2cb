"""Types of the detectors: images, results, and the protocol of corner detectors."""

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels

Image = NDArray[np.uint8]
"""Grey (H, W) or BGR (H, W, 3), as in OpenCV."""

CORNER_DECIMALS = 4
"""Decimals of the corners' pixels."""

DepthImage = NDArray[np.uint16]
"""(H, W): the depth along the optical axis as in `calibration.engine.dataset.sensor_data`."""


@dataclass(frozen=True)
class NotDetected:
    """Result of a detector if the pattern is not detected."""

    reason: str
    """Short reason for a user, such as "7 markers, more than 8 are needed"."""


def grey(image: NDArray[Any]) -> Image:
    """Convert an image to grey, (H, W).

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
    """Corner detector of one pattern.

    Created once and used for many images: the result for an image does not depend on previous ones, nor on
    the process. Ids are those of `calibration.engine.dataset.pattern.grid`: ``row * columns + column``, x
    along a row, y along a column, z away from the camera.
    """

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        ...
