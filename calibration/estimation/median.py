"""Median without NaN handling."""

import numpy as np

from calibration.geometry.types import Array

MANY = 10_000
"""Numbers from which those near the median are sorted out first."""


def median(values: Array) -> float:
    """Return the median of an array of any shape, without NaN; NaN for an empty one.

    Like `numpy.median`, which imports `numpy.ma`, a fifth of the engine's start-up time.
    """
    flat = np.ravel(values)
    if not flat.size:
        return float("nan")
    low, high = (flat.size - 1) // 2, flat.size // 2
    if flat.size > MANY:  # an estimate from every 50th number tells between which numbers the median is
        sample = np.sort(flat[::50])
        near = flat[(flat >= sample[int(0.4 * len(sample))]) & (flat <= sample[int(0.6 * len(sample))])]
        below = int(np.count_nonzero(flat < sample[int(0.4 * len(sample))]))
        if below <= low and high < below + len(near):
            flat, low, high = near, low - below, high - below
    ranked = np.partition(flat, [low, high])
    return 0.5 * float(ranked[low] + ranked[high])
