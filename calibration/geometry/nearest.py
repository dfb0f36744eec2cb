"""Nearest neighbours among a few thousand points, by all distances at once."""

import numpy as np

from calibration.geometry.types import Array, IntArray

_CHUNK = 1 << 20  # distances at a time, to bound the memory


def nearest(points: Array, among: Array) -> IntArray:
    """Which of the points `among` (M, D), M > 0, lies nearest to each of `points` (N, D): (N,)."""
    centre = among.mean(0)  # near the origin the expanded square loses no digits
    rest = among - centre
    squares = (rest * rest).sum(-1)
    found = np.empty(len(points), int)
    step = max(1, _CHUNK // len(among))
    for start in range(0, len(points), step):
        part = points[start : start + step] - centre
        found[start : start + step] = (squares - 2 * part @ rest.T).argmin(-1)
    return found
