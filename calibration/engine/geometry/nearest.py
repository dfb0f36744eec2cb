"""Brute-force nearest neighbours for a few thousand points."""

import numpy as np

from calibration.base.arrays import Array, IntArray

_CHUNK = 1 << 20  # chunk size (number of distances), to bound the memory


def nearest(points: Array, among: Array) -> IntArray:
    """Return the index (N,) of the point in `among` (M, D), M > 0, nearest to each of `points` (N, D)."""
    centre = among.mean(0)  # centred, because the expanded square loses digits far from the origin
    rest = among - centre
    squares = (rest * rest).sum(-1)
    found = np.empty(len(points), int)
    step = max(1, _CHUNK // len(among))
    for start in range(0, len(points), step):
        part = points[start : start + step] - centre
        found[start : start + step] = (squares - 2 * part @ rest.T).argmin(-1)
    return found
