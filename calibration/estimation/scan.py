"""Border of a pattern in a LiDAR's rings: its position between two rays."""

import numpy as np

from calibration.estimation.median import median
from calibration.geometry.types import Array, BoolArray, IntArray

RING_GAP = 5e-4
"""rad: points whose polar angles differ by more are on different rings."""


def border_rays(points: Array, limits: IntArray) -> Array:
    """Return points on the rays to the border, one for each limit point, as accurately as the scan allows.

    A limit point is the last one of its ring *on* the pattern: the border is somewhere between it
    and the next ray, on average half a step of the scan farther out. So each limit point is rotated by
    half its ring's step in azimuth, away from the ring's other points; the range is unchanged. Without this
    a pattern would look smaller by one step of the scan, 6 mm at 2 m for a step of 0.2 degrees.

    Args:
        points: (N, 3), the points on the pattern in the sensor's frame, m.
        limits: (L,), indices of those on the border.

    Returns:
        (L, 3); NaN for limit points alone on their ring, because the side of the pattern is unknown.
    """
    turns = np.full(len(points), np.nan)
    azimuth = _azimuth(points)
    for ring in _rings(points):
        if len(ring) > 1:
            order = ring[np.argsort(azimuth[ring])]
            half_step = 0.5 * median(np.diff(azimuth[order]))
            turns[order[1:-1]] = 0.0
            turns[order[0]], turns[order[-1]] = -half_step, half_step
    cos, sin = np.cos(turns[limits]), np.sin(turns[limits])
    x, y, z = points[limits].T
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.where(np.isnan(cos), np.nan, z)], -1)


def _azimuth(points: Array) -> Array:
    """Return azimuths (N,) relative to the direction of their mean, contiguous for a pattern across +-180 degrees."""
    middle = points.mean(axis=0)
    absolute = np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(middle[1], middle[0])
    wrapped: Array = np.mod(absolute + np.pi, 2 * np.pi) - np.pi
    return wrapped


def _rings(points: Array) -> list[IntArray]:
    """Return the indices of the points of each ring: equal polar angle."""
    polar = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    order = np.argsort(polar, kind="stable")
    gap: BoolArray = np.diff(polar[order]) > RING_GAP
    return np.split(order, np.flatnonzero(gap) + 1)
