"""Median without NaN handling."""

import numpy as np

from calibration.geometry.types import Array


def median(values: Array) -> float:
    """Return the median of an array of any shape, without NaN; NaN for an empty one.

    Like `numpy.median`, which imports `numpy.ma`, a fifth of the engine's start-up time.
    """
    flat = np.ravel(values)
    if not flat.size:
        return float("nan")
    low, high = (flat.size - 1) // 2, flat.size // 2
    ranked = np.partition(flat, [low, high])
    return 0.5 * float(ranked[low] + ranked[high])
