"""Detection of level changes and slow drift in a series of measurements.

The levels are the segmentation with the least ``sum |x_i - mean of its segment|^2 / s^2 + penalty * changes``, found
exactly by optimal partitioning (B. Jackson et al., "An algorithm for optimal partitioning of data on an interval",
2005). The penalty is a quantile of chi-squared, so that the false alarm rate of a constant series is 0.001.
"""

import math
from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.baseline.comparison import chi_squared_quantile
from calibration.engine.estimation.covariance.significance import FAMILY_WISE

MAD_TO_SIGMA = 1.4826
"""Ratio of standard deviation to median absolute deviation of a normal distribution."""
MIN_VALUES = 4
"""Minimum number of values for a trend."""
MIN_VALUES_FOR_NOISE = 12
"""Least number of values for which the noise is estimated from their differences."""
MIN_NOISE_SHARE = 0.02
"""Lower limit of the noise, as a fraction of the stated one."""


def noise_of(values: Array, stated: Array) -> Array:
    """Estimate the standard deviation of each column of a series from its differences; short series: the stated one.

    It is the larger of the two halves' estimates, so that increasing noise is not detected as changes of the level.

    Args:
        values: (n, d).
        stated: (d,), positive.
    """
    if len(values) < MIN_VALUES_FOR_NOISE:
        return stated
    steps = np.diff(values, axis=0)
    halves = np.array_split(steps, 2)
    deviations = [np.median(np.abs(half - np.median(half, axis=0)), axis=0) for half in halves]
    noise: Array = np.maximum(MAD_TO_SIGMA * np.max(deviations, axis=0) / math.sqrt(2), MIN_NOISE_SHARE * stated)
    return noise


def change_points(values: Array, noise: Array) -> list[int]:
    """Return the indices at which the level of a series changes.

    Args:
        values: (n, d), with d at most 6.
        noise: (d,), the standard deviation of each column.
    """
    n = len(values)
    if n < 2:
        return []
    white = (values - values[0]) / noise
    sums = np.concatenate([np.zeros((1, white.shape[1])), np.cumsum(white, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum((white**2).sum(axis=1))])
    penalty = chi_squared_quantile(FAMILY_WISE / n)
    best = np.zeros(n + 1)
    best[0] = -penalty
    last: IntArray = np.zeros(n + 1, int)
    for end in range(1, n + 1):
        starts = np.arange(end)
        cost = squares[end] - squares[:end] - ((sums[end] - sums[:end]) ** 2).sum(axis=1) / (end - starts)
        total = best[:end] + cost + penalty
        last[end] = int(total.argmin())
        best[end] = total[last[end]]
    found: list[int] = []
    at = n
    while (at := int(last[at])) > 0:
        found.insert(0, at)
    return found


def creeps(values: Array, noise: Array, changes: Sequence[int]) -> bool:
    """Whether a straight line explains a series better than levels, with a penalty for each parameter.

    Args:
        values: (n, d).
        noise: (d,), the standard deviation of each column.
        changes: the indices from `change_points`.
    """
    n = len(values)
    if n < MIN_VALUES:
        return False
    white = values / noise
    penalty = chi_squared_quantile(FAMILY_WISE / n)
    levels = sum(float(((part - part.mean(axis=0)) ** 2).sum()) for part in np.split(white, list(changes)))
    at = np.arange(n) - (n - 1) / 2
    centred = white - white.mean(axis=0)
    slope = at @ centred / (at @ at)
    line = float(((centred - np.outer(at, slope)) ** 2).sum())
    return line + penalty < min(levels + penalty * len(changes), float((centred**2).sum()))
