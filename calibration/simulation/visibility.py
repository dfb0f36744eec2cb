"""What a camera can see of points in front of it: on its image, and from a side that shows."""

import math

import numpy as np

from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array, BoolArray

MAX_VIEW_ANGLE = math.radians(65)
"""Between the pattern's normal and the line of sight: beyond it detectors lose more and more of a pattern."""


def facing(T_sensor_pattern: Array, centre: Array) -> BoolArray:
    """Which poses (..., 4, 4) show the sensor the front of the pattern, within `MAX_VIEW_ANGLE`.

    The pattern's z axis points away from a sensor that sees it; centre (3,) is in the pattern's frame.
    """
    sensor = inverse(T_sensor_pattern)[..., :3, 3] - centre
    front: BoolArray = -sensor[..., 2] > math.cos(MAX_VIEW_ANGLE) * np.linalg.norm(sensor, axis=-1)
    return front


def corners_in_image(camera: Camera, points: Array) -> tuple[Array, BoolArray]:
    """Pixels (..., K, 2) of points (..., K, 3) in the camera frame, and which of them (..., K) are on the image."""
    pixels, visible = camera.project_visible(points)
    return pixels, visible & camera.contains(pixels)
