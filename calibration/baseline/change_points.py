"""Where a series of measurements changes its level, and whether it creeps.

The levels are the segmentation with the least ``sum |x_i - mean of its segment|^2 / s^2 + penalty * changes``, found
exactly by optimal partitioning (B. Jackson et al., "An algorithm for optimal partitioning of data on an interval",
2005); the penalty is a quantile of chi-squared, so that a series without a change has one with a probability of 0.001.
"""

import math
from collections.abc import Sequence

import numpy as np

from calibration.baseline.comparison import chi_squared_quantile
from calibration.estimation.significance import FAMILY_WISE
from calibration.geometry.types import Array, IntArray

NORMAL = 1.4826
"""The standard deviation of normal numbers over their median absolute deviation."""
FEWEST = 4
"""With fewer values there is no trend."""
MANY = 12
"""From so many values on their differences tell their noise."""
LEAST = 0.02
"""Of the noise that is stated there is at least this part."""


def noise_of(values: Array, stated: Array) -> Array:
    """The standard deviation of each column of a series, from its differences; what is stated of it where they are few.

    It is the larger of two halves', so that a series that becomes noisier does not seem to jump.

    Args:
        values: (n, d).
        stated: (d,), positive.
    """
    if len(values) < MANY:
        return stated
    steps = np.diff(values, axis=0)
    halves = np.array_split(steps, 2)
    deviations = [np.median(np.abs(half - np.median(half, axis=0)), axis=0) for half in halves]
    noise: Array = np.maximum(NORMAL * np.max(deviations, axis=0) / math.sqrt(2), LEAST * stated)
    return noise


def change_points(values: Array, noise: Array) -> list[int]:
    """The indices at which a series has another level than before.

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
    """Whether a straight line explains a series better than levels, each parameter being paid for.

    Args:
        values: (n, d).
        noise: (d,), the standard deviation of each column.
        changes: the indices that `change_points` finds.
    """
    n = len(values)
    if n < FEWEST:
        return False
    white = values / noise
    penalty = chi_squared_quantile(FAMILY_WISE / n)
    levels = sum(float(((part - part.mean(axis=0)) ** 2).sum()) for part in np.split(white, list(changes)))
    at = np.arange(n) - (n - 1) / 2
    centred = white - white.mean(axis=0)
    slope = at @ centred / (at @ at)
    line = float(((centred - np.outer(at, slope)) ** 2).sum())
    return line + penalty < min(levels + penalty * len(changes), float((centred**2).sum()))
