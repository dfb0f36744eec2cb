"""Rays of a camera's pixels, and the samples of a pixel."""

from functools import lru_cache

import numpy as np

from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array, IntArray

SAMPLES = 16
"""Number of samples of a pixel that sees several surfaces."""
_OFFSETS = [((i + 0.5) / SAMPLES - 0.5, (int(f"{i:04b}"[::-1], 2) + 0.5) / SAMPLES - 0.5) for i in range(SAMPLES)]
"""(y, x) of the samples from the pixel's centre, px: J. M. Hammersley's points (1960). No two share one of 16 rows
or columns, so an edge along an axis is found to 1/16 px."""


@lru_cache(maxsize=8)
def rays(camera: Camera) -> Array:
    """Return the rays (3, height + 2, width + 2): (x, y, 1) for each pixel, with a margin of one on every side.

    With the margin every pixel of the image has differences to both neighbours. NaN where the distortion has no
    inverse. The distance along such a ray is the depth along the optical axis.
    """
    v, u = np.mgrid[-1 : camera.height + 1, -1 : camera.width + 1].astype(float)
    found = _rays(camera, u, v)
    found.flags.writeable = False
    return found


def sample_rays(camera: Camera, rows: IntArray, columns: IntArray) -> Array:
    """Return the rays (3, N, SAMPLES) of the samples of N pixels."""
    dv, du = np.array(_OFFSETS).T
    return _rays(camera, columns[:, None] + du, rows[:, None] + dv)


def _rays(camera: Camera, u: Array, v: Array) -> Array:
    xy = camera.normalise(np.stack([u, v], -1))
    return np.stack([xy[..., 0], xy[..., 1], np.where(np.isnan(xy[..., 0]), np.nan, 1.0)])


def rounded(T: Array) -> Array:
    """Round a pose (4, 4) to a picometre, so that rounding errors of the arithmetic have no effect on an image."""
    return np.round(T, 12)
