"""What a camera labels on a pattern: the corners that a detector would find, with its noise."""

import math

import numpy as np

from calibration.dataset.model import CornerLabels
from calibration.dataset.pattern import Pattern
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.sensors import SimulatedCamera

DETECTED_SHARE = 0.25
"""A pattern is detected when more than this share of its corners is (ATOM's rule)."""
MAX_VIEW_ANGLE = math.radians(75)
"""Between the pattern's normal and the line of sight: beyond it a square shrinks to a quarter of its width."""


def facing(T_camera_pattern: Array, centre: Array) -> BoolArray:
    """Which poses (..., 4, 4) show the camera the front of the pattern, within `MAX_VIEW_ANGLE`.

    The pattern's z axis points away from a camera that sees it; centre (3,) is in the pattern's frame.
    """
    camera = inverse(T_camera_pattern)[..., :3, 3] - centre
    front: BoolArray = -camera[..., 2] > math.cos(MAX_VIEW_ANGLE) * np.linalg.norm(camera, axis=-1)
    return front


def corners_in_image(camera: Camera, points: Array) -> tuple[Array, BoolArray]:
    """Pixels (..., K, 2) of points (..., K, 3) in the camera frame, and which of them (..., K) are on the image."""
    pixels, visible = camera.project_visible(points)
    return pixels, visible & camera.contains(pixels)


def label_corners(
    sensor: SimulatedCamera,
    pattern: Pattern,
    T_camera_pattern: Array,
    hidden: BoolArray,
    random: np.random.Generator,
) -> CornerLabels | None:
    """The labels of one view, or None where the pattern is not detected.

    Args:
        sensor: the camera.
        pattern: what it looks at.
        T_camera_pattern: (4, 4), to the camera's optical frame.
        hidden: (K,), corners behind something.
        random: gives two numbers for every corner of the pattern, seen or not, so that what is
            seen does not change the noise of the others.
    """
    noise = sensor.noise * random.standard_normal((len(pattern.corners), 2))
    pixels, visible = corners_in_image(sensor.camera, apply(T_camera_pattern, pattern.corners))
    noisy = np.round(pixels + noise, 4)
    ids = np.flatnonzero(visible & sensor.camera.contains(noisy) & ~hidden)
    if len(ids) <= DETECTED_SHARE * len(pattern.corners) or not facing(T_camera_pattern, pattern.centre):
        return None
    return CornerLabels(ids, noisy[ids])
