"""Median without NaN handling."""

import numpy as np

from calibration.base.arrays import Array

MIN_NUMBERS_TO_NARROW = 10_000
"""Numbers from which those near the median are sorted out first."""


def median(values: Array) -> float:
    """Return the median of an array of any shape, without NaN; NaN for an empty one.

    Like `numpy.median`, which imports `numpy.ma`, a fifth of the engine's start-up time.
    """
    flat = np.ravel(values)
    if not flat.size:
        return float("nan")
    low, high = (flat.size - 1) // 2, flat.size // 2
    if (
        flat.size > MIN_NUMBERS_TO_NARROW
    ):  # an estimate from every 50th number tells between which numbers the median is
        sample = np.sort(flat[::50])
        least, most = sample[int(0.4 * len(sample))], sample[int(0.6 * len(sample))]
        near = flat.compress((flat >= least) & (flat <= most))
        below = int(np.count_nonzero(flat < least))
        if below <= low and high < below + len(near):
            flat, low, high = near, low - below, high - below
    ranked = np.partition(flat, high)  # for one number, which takes a fifth of the time of that for two
    return 0.5 * float((ranked[high] if low == high else ranked[:high].max()) + ranked[high])
