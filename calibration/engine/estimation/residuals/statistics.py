"""Median, and the significance of a statistic as a standard score, without tables of chi-squared or F."""

import math

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
    if flat.size > MIN_NUMBERS_TO_NARROW:
        # an estimate from every 50th number tells between which numbers the median is
        sample = np.sort(flat[::50])
        least, most = sample[int(0.4 * len(sample))], sample[int(0.6 * len(sample))]
        near = flat.compress((flat >= least) & (flat <= most))
        below = int(np.count_nonzero(flat < least))
        if below <= low and high < below + len(near):
            flat, low, high = near, low - below, high - below
    ranked = np.partition(flat, high)  # for one number, which takes a fifth of the time of that for two
    return 0.5 * float((ranked[high] if low == high else ranked[:high].max()) + ranked[high])


FAMILY_WISE = 1e-3
"""Probability of any significant suspect in a run of a faultless robot."""


def threshold(tests: int) -> float:
    """Return the standard score at which one of this many tests is significant, family-wise (Bonferroni)."""
    return score_of_tail(FAMILY_WISE / max(1, tests))


def score_of_tail(probability: float) -> float:
    """Return the standard score that a normal variable exceeds with this probability, which is below 1/2.

    By Newton's method for the logarithm of the probability; `statistics`, which has it too, is slow to import.
    """
    score = math.sqrt(-2 * math.log(2 * probability))
    for _ in range(6):  # five steps reach the last digit
        tail = math.erfc(score / math.sqrt(2)) / 2
        density = math.exp(-(score**2) / 2) / math.sqrt(2 * math.pi)
        score += math.log(tail / probability) * tail / density
    return score


def score_of_f(F: float | Array, k: float | Array, freedom: float) -> Array:
    """Convert F with k and ``freedom`` degrees of freedom to a standard score.

    E. Paulson, "An approximate normalization of the analysis of variance distribution", 1942: the cube root of F is
    nearly normal. Accurate to a few per cent in the tails from four degrees of freedom on.
    """
    a, b = 2 / (9 * k), 2 / (9 * freedom)
    root = F ** (1 / 3)
    return ((1 - b) * root - (1 - a)) / (b * root**2 + a) ** 0.5
