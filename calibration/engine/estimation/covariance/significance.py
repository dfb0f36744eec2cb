"""Significance of a statistic as a standard score, comparable between chi-squared and F, without tables of either."""

import math

from calibration.base.arrays import Array

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
    score: Array = ((1 - b) * root - (1 - a)) / (b * root**2 + a) ** 0.5
    return score
