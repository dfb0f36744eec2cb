"""What a lens and a chip make of the light: blur, vignetting, exposure, noise, 8 bits."""

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.cameras import Camera
from calibration.labelling.detection import Image
from calibration.simulation.rendering.background import STEPS
from calibration.simulation.sensors import SimulatedCamera

_ROWS = 64
"""So many rows are worked on at a time: they stay in the cache."""


def take(sensor: SimulatedCamera, radiance: NDArray[np.uint16], random: np.random.Generator) -> Image:
    """The image (height, width, 3) of light (height, width, 3) in `STEPS` of a grey level.

    The noise is of brightness: one number for each pixel, the same on its three colours, and drawn
    for every pixel whatever it sees. What is too bright is white.
    """
    noise = random.standard_normal(radiance.shape[:2], dtype=np.float32)
    noise *= np.float32(sensor.noise)
    gain = _gain(sensor.camera, sensor.vignetting) * np.float32(sensor.exposure / STEPS)
    planes = [np.empty(noise.shape, np.uint8) for _ in range(3)]
    for light, levels in zip(cv2.split(_blurred(radiance, sensor.blur)), planes, strict=True):
        for row in range(0, len(levels), _ROWS):
            rows = slice(row, row + _ROWS)
            # the sum is rounded and kept within 8 bits
            cv2.add(cv2.multiply(light[rows], gain[rows], dtype=cv2.CV_32F), noise[rows], levels[rows], dtype=cv2.CV_8U)
    return np.asarray(cv2.merge(planes), np.uint8)


def _blurred(radiance: NDArray[np.uint16], sigma: float) -> NDArray[np.uint16]:
    """OpenCV's blur of whole numbers, which every machine computes alike."""
    if sigma <= 0:
        return radiance
    size = 2 * math.ceil(3 * sigma) + 1
    return np.asarray(cv2.GaussianBlur(radiance, (size, size), sigma), np.uint16)


@lru_cache(maxsize=8)
def _gain(camera: Camera, vignetting: float) -> NDArray[np.float32]:
    """(height, width): 1 on the optical axis, falling like cos^4 of the angle to it down to the farthest corner."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height)[:, None] - camera.cy) / camera.fy
    loss = 1 - 1 / (1 + x * x + y * y) ** 2
    gain: NDArray[np.float32] = (1 - vignetting * loss / max(float(loss.max()), 1e-12)).astype(np.float32)
    return gain
