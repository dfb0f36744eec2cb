"""What detectors take and answer, whatever the sensor."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    import cv2

    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
