"""Rays to the border of a pattern: between two rays of a LiDAR's ring, or two pixels of a depth image."""

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera

RING_GAP = 5e-4
"""rad: points whose polar angles differ by more are on different rings."""
PIXELS_ON_EITHER_SIDE = 6
"""Number of pixels before and after a limit pixel that determine the border's direction."""
MIN_COSINE_IF_STRAIGHT = np.cos(np.radians(20))
"""If the directions before and after a pixel differ by more, it is at a corner of the pattern, or at a gap. On a
straight border they differ by at most a pixel's step in `PIXELS_ON_EITHER_SIDE` each, 19 degrees.
"""


def scan_border_rays(points: Array, limits: IntArray, views: IntArray | None = None) -> Array:
    """Return points on the rays to the border, one for each limit point, as accurately as the scan allows.

    A limit point is the last one of its ring *on* the pattern: the border is somewhere between it
    and the next ray, on average half a step of the scan farther out. So each limit point is rotated by
    half its ring's step in azimuth, away from the ring's other points; the range is unchanged. Without this
    a pattern would look smaller by one step of the scan, 6 mm at 2 m for a step of 0.2 degrees.

    Args:
        points: (N, 3), the points on the pattern in the sensor's frame, m.
        limits: (L,), indices of those on the border.
        views: (N,), the view of each point, from 0; None if all are of one.

    Returns:
        (L, 3); NaN for limit points alone on their ring, because the side of the pattern is unknown.
    """
    x, y, z = np.ascontiguousarray(points.T)
    views = np.zeros(len(points), int) if views is None else views
    ring, azimuth = _ring_numbers(np.arctan2(np.sqrt(x * x + y * y), z), views), _relative_azimuths(x, y, views)
    order = _sorted_within(ring, azimuth)
    turns = np.empty(len(points))
    turns[order] = _turns_by_half_a_step(azimuth[order], ring[order])
    cos, sin = np.cos(turns[limits]), np.sin(turns[limits])
    x, y, z = points[limits].T
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.where(np.isnan(cos), np.nan, z)], -1)


def _relative_azimuths(x: Array, y: Array, views: IntArray) -> Array:
    """Return azimuths (N,) relative to the direction of their view's mean, contiguous for one across +-180 degrees."""
    u, v = (np.bincount(views, each)[views] for each in (x, y))
    azimuth: Array = np.arctan2(u * y - v * x, u * x + v * y)
    return azimuth


def _ring_numbers(polar: Array, views: IntArray) -> IntArray:
    """Return the number of the ring (N,) of each point: equal view and polar angle."""
    order = _sorted_within(views, polar)
    rings = np.zeros(len(polar), int)
    rings[order[1:]] = np.cumsum((np.diff(polar[order]) > RING_GAP) | (np.diff(views[order]) != 0))
    return rings


def _sorted_within(groups: IntArray, angles: Array) -> IntArray:
    """Return the order (N,) by groups, and in a group by angles, rad; as `numpy.lexsort`, at half the cost."""
    return np.argsort(angles + 8.0 * groups, kind="stable")


def _turns_by_half_a_step(azimuth: Array, rings: IntArray) -> Array:
    """Return the turns (N,) of points by half their ring's median step: of the ends of rings, outwards; 0 of others.

    Args:
        azimuth: (N,), ascending in each ring.
        rings: (N,), numbers of the rings, ascending.
    """
    turns = np.zeros(len(azimuth))
    first = np.flatnonzero(np.diff(rings, prepend=-1))
    last = np.append(first[1:], len(rings))[: len(first)] - 1
    inside = np.diff(rings) == 0
    steps, of = np.diff(azimuth)[inside], rings[1:][inside]
    ranked = steps[_sorted_within(of, steps)]
    several = last > first
    turns[first[~several]] = np.nan
    before = (first - np.arange(len(first)))[several]  # number of steps of the rings before it
    count = (last - first)[several]
    half_step = 0.25 * (ranked[before + (count - 1) // 2] + ranked[before + count // 2])
    turns[first[several]], turns[last[several]] = -half_step, half_step
    return turns


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
