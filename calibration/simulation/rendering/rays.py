"""Rays of a camera's pixels, and the samples of a pixel."""

from functools import lru_cache

import numpy as np

from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array, IntArray

SAMPLES = 16
"""Number of samples of a pixel that sees several surfaces."""
TILE = (16, 32)
"""Height and width of a tile of the image, px."""
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


@lru_cache(maxsize=8)
def cones(camera: Camera) -> tuple[Array, Array]:
    """Cones around the rays of the image's tiles, of `TILE` pixels each.

    Returns:
        Their axes (R, C, 3), unit vectors in the camera's frame, and the sines (R, C) of the largest angles to them,
        NaN for a tile in part of which the lens shows nothing.
    """
    height, width = TILE
    found = rays(camera)
    units = np.moveaxis(found / np.sqrt((found * found).sum(axis=0)), 0, -1)
    axes = np.empty((-(-camera.height // height), -(-camera.width // width), 3))
    sines = np.empty(axes.shape[:2])
    for row, column in np.ndindex(*sines.shape):
        tile = units[row * height : (row + 1) * height + 2, column * width : (column + 1) * width + 2].reshape(-1, 3)
        axis = tile.mean(axis=0)
        axes[row, column] = axis / np.sqrt(axis @ axis)
        cosine = (tile @ axes[row, column]).min()
        sines[row, column] = np.sqrt(max(0.0, 1 - cosine * cosine)) if cosine > 0 else np.nan
    for array in (axes, sines):
        array.flags.writeable = False
    return axes, sines


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
