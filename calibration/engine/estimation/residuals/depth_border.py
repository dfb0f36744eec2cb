"""Border of a pattern in a depth image: its position next to the limit pixels."""

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera

PIXELS_ON_EITHER_SIDE = 6
"""Number of pixels before and after a limit pixel that determine the border's direction."""
MIN_COSINE_IF_STRAIGHT = np.cos(np.radians(20))
"""If the directions before and after a pixel differ by more, it is at a corner of the pattern, or at a gap. On a
straight border they differ by at most a pixel's step in `PIXELS_ON_EITHER_SIDE` each, 19 degrees.
"""


def depth_border_rays(points: Array, limits: IntArray, camera: Camera) -> Array:
    """Return points on the rays to the border, one for each limit point, as accurately as the pixels allow.

    A limit pixel is the last one *on* the pattern of its row or column, whichever crosses the border
    more steeply: the border runs somewhere between it and the next pixel of that row or column, on
    average half a pixel farther out. So each is moved by half a pixel along that axis, away from the
    pattern; the depth is kept.

    Where a border runs along the rows or columns so well that no step from one to the next is near,
    all its pixels have the same error, of up to half a pixel, which does not average out: they are
    rejected. The errors of those around a step average to zero.

    Args:
        points: (N, 3), the points on the pattern in the optical frame, m.
        limits: (L,), indices of those on the border.
        camera: the intrinsics.

    Returns:
        (L, 3); NaN if the limit pixels around one do not locate the border: no step, a corner, a gap.
    """
    pixels = np.rint(camera.project(points[limits]))
    step = _outward_steps(pixels, camera.project(points).mean(axis=0))
    x, y = camera.normalise(pixels + 0.5 * step).T
    z = np.where(np.isnan(x), np.nan, points[limits, 2])
    return np.stack([x * z, y * z, z], -1)


def _outward_steps(pixels: Array, centre: Array) -> Array:
    """Return the unit step (L, 2) along rows or columns out of a convex region at its border pixels; else NaN."""
    if len(pixels) < 2 * PIXELS_ON_EITHER_SIDE + 1:
        return np.full_like(pixels, np.nan)
    order = np.argsort(np.arctan2(*(pixels - centre).T[::-1]), kind="stable")
    around = pixels[order]
    after, before = (
        np.roll(around, -PIXELS_ON_EITHER_SIDE, axis=0) - around,
        around - np.roll(around, PIXELS_ON_EITHER_SIDE, axis=0),
    )
    along = after + before
    normal = np.stack([along[:, 1], -along[:, 0]], -1)  # outward: with y down, angles grow clockwise
    straight = (after * before).sum(-1) > MIN_COSINE_IF_STRAIGHT * np.linalg.norm(after, axis=-1) * np.linalg.norm(
        before, axis=-1
    )
    rows = np.abs(normal[:, 0]) > np.abs(normal[:, 1])
    step = np.where(np.stack([rows, ~rows], -1), np.sign(normal), 0.0)
    out = np.empty_like(pixels)
    stepped = (along != 0).all(-1)
    out[order] = np.where((straight & stepped)[:, None], step, np.nan)
    return out
