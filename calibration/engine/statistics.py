"""Statistics without tables: medians, significance as a standard score, distances of Gaussians, levels of a series.

In a series of measurements, levels that change and a slow drift are found. The levels are the segmentation with the
least ``sum |x_i - mean of its segment|^2 / s^2 + penalty * changes``, found exactly by optimal partitioning (B. Jackson
et al., "An algorithm for optimal partitioning of data on an interval", 2005). The penalty is a quantile of chi-squared,
so that the false alarm rate of a constant series is 0.001.

An error ``e ~ N(0, S)`` of three axes is ``e = r s(u)``: a direction u, even over the sphere, a length r with the
distribution F of Maxwell, and the error s(u) by a unit step along u. So ``P(|e| <= x)`` is the mean of
``F(x / |s(u)|)`` over all directions, by Gauss's rule along the axis of the largest error and the midpoint rule about
it. Errors of one or two axes are those of three of which some are zero.
"""

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np

from calibration.base.arrays import Array, IntArray


def median(values: Array) -> float:
    """Return the median of an array of any shape, without NaN; NaN for an empty one.

    Like `numpy.median`, which imports `numpy.ma`, a fifth of the engine's start-up time.
    """
    flat = np.ravel(values)
    if not flat.size:
        return float("nan")
    low, high = (flat.size - 1) // 2, flat.size // 2
    ranked = np.partition(flat, high)  # for one number, which takes a fifth of the time of that for two
    return 0.5 * float((ranked[high] if low == high else ranked[:high].max()) + ranked[high])


FAMILY_WISE = 1e-3
"""Probability of any significant suspect in a run of a faultless robot."""


def threshold(tests: int) -> float:
    """Return the standard score at which one of this many tests is significant, family-wise (Bonferroni)."""
    return score_of_tail(FAMILY_WISE / max(1, tests))


def score_of_tail(probability: float) -> float:
    """Return the standard score that a normal variable exceeds with this probability."""
    return -NormalDist().inv_cdf(probability)


def score_of_f(F: float | Array, k: float | Array, freedom: float) -> Array:
    """Convert F with k and ``freedom`` degrees of freedom to a standard score.

    E. Paulson, "An approximate normalization of the analysis of variance distribution", 1942: the cube root of F is
    nearly normal. Accurate to a few per cent in the tails from four degrees of freedom on.
    """
    a, b = 2 / (9 * k), 2 / (9 * freedom)
    root = F ** (1 / 3)
    return ((1 - b) * root - (1 - a)) / (b * root**2 + a) ** 0.5


MOST_FREEDOM = 1e6
"""Upper limit of the degrees of freedom; beyond it the distribution is practically chi-squared."""
MIN_VARIANCE_RATIO = 1e-9
"""Relative to the largest: a smaller variance is rounding error."""


def squared_mahalanobis(d: Array, C: Array) -> float:
    """Return ``d^T C^-1 d``."""
    scale = np.sqrt(np.maximum(np.diagonal(C), 1e-300))
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    values = np.maximum(values, MIN_VARIANCE_RATIO * values[-1])
    white = vectors.T @ (d / scale) / np.sqrt(values)
    return float(white @ white)


def t_squared_tail(x: float, k: int, freedom: float) -> float:
    """Probability that Hotelling's T^2 of k parameters exceeds x under the null hypothesis.

    1 if there are too few degrees of freedom.
    """
    n = min(freedom, MOST_FREEDOM)
    if n - k + 1 < 1 or x <= 0:
        return 1.0
    if math.isinf(x):
        return 0.0
    score = float(score_of_f(x * (n - k + 1) / (k * n), k, n - k + 1))
    return 0.5 * math.erfc(score / math.sqrt(2))


def t_squared_quantile(p: float, freedom: float) -> float:
    """Value that Hotelling's T^2 of 6 parameters exceeds with probability p; infinite if ``freedom`` is too small."""
    return _solve_tail(lambda x: t_squared_tail(x, 6, freedom), p)


def chi_squared_quantile(p: float) -> float:
    """Quantile that chi-squared with 6 degrees of freedom exceeds with probability p."""
    return _solve_tail(chi_squared_tail, p)


def chi_squared_tail(x: float) -> float:
    """Probability that chi-squared with 6 degrees of freedom exceeds x.

    ``exp(-x/2) (1 + x/2 + x^2/8)`` (M. Abramowitz, I. Stegun, "Handbook of mathematical functions", 26.4.21).
    """
    return math.exp(-x / 2) * (1 + x / 2 + x * x / 8) if x < 1400 else 0.0


def _solve_tail(tail: Callable[[float], float], p: float) -> float:
    """Solve ``tail(x) = p`` for a decreasing function; infinite if there is no solution below the search limit."""
    low, high = 0.0, 1e6
    if tail(high) > p:
        return math.inf
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle) > p else (low, middle)
    return high


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
    return np.asarray(np.maximum(MAD_TO_SIGMA * np.max(deviations, axis=0) / math.sqrt(2), MIN_NOISE_SHARE * stated))


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


TURNS = 4
"""Directions of a quadrant about the axis."""
NEWTON_STEPS = 3
_LENGTHS = np.linspace(0.0, 8.0, 1601)
_DENSITY = np.sqrt(2 / np.pi) * _LENGTHS**2 * np.exp(-(_LENGTHS**2) / 2)
_DISTRIBUTION = np.append(0.0, np.cumsum((_DENSITY[1:] + _DENSITY[:-1]) / 2)) * (_LENGTHS[1] - _LENGTHS[0])


def quantile_of_norm(S: Array, probability: float) -> Array:
    """Return the quantile (n,) of the norm of errors with covariances (n, k, k), k up to 3; 0 of none."""
    sizes, weights = _sizes_by_direction(S)
    low, high = np.zeros(len(S)), _LENGTHS[-1] * sizes.max(1)
    x = np.interp(probability, _DISTRIBUTION, _LENGTHS) * np.sqrt((sizes**2) @ weights)
    for _ in range(NEWTON_STEPS):
        reached, slope = _probability_within(x, sizes, weights)
        low, high = np.where(reached < probability, x, low), np.where(reached < probability, high, x)
        step = x + (probability - reached) / np.maximum(slope, 1e-300)
        x = np.where((step >= low) & (step <= high), step, (low + high) / 2)
    return x


def probability_beyond(S: Array, limit: float) -> Array:
    """Return the probability (n,) that the norm of errors with covariances (n, k, k) exceeds a limit."""
    sizes, weights = _sizes_by_direction(S)
    return np.maximum(0.0, 1 - _probability_within(np.full(len(S), limit), sizes, weights)[0])


def median_of_norm(mean: Array, C: Array) -> float:
    """Return the median norm of an error with a mean (k,) and a covariance (k, k), to a few per cent.

    A chi-square variable of the same mean and variance (P. B. Patnaik, 1949), by the cube root of E. B. Wilson and
    M. M. Hilferty (1931).
    """
    square, variance = float(mean @ mean + np.trace(C)), float(2 * np.trace(C @ C) + 4 * mean @ C @ mean)
    return float(np.sqrt(square * max(0.0, 1 - variance / (9 * square**2)) ** 3)) if square > 0 else 0.0


def size_without_error(x: Array, errors: Array) -> float:
    """Return the size of an estimate x (k,) without what its independent errors (k, r) make it longer.

    Along each axis of their covariance ``E (x + e)^2 = x^2 + sigma^2``; what is left of a square is not negative.
    """
    variances, axes = np.linalg.eigh(errors @ errors.T)
    return float(np.sqrt(np.maximum(0.0, (axes.T @ x) ** 2 - variances).sum()))


def _probability_within(x: Array, sizes: Array, weights: Array) -> tuple[Array, Array]:
    """Return the probability (n,) of an error up to x (n,), and its derivative."""
    with np.errstate(divide="ignore", invalid="ignore"):
        lengths = np.where(sizes > 0, x[:, None] / sizes, _LENGTHS[-1])
        slopes = np.where(sizes > 0, np.interp(lengths, _LENGTHS, _DENSITY) / sizes, 0.0)
    return np.interp(lengths, _LENGTHS, _DISTRIBUTION) @ weights, slopes @ weights


def _sizes_by_direction(S: Array) -> tuple[Array, Array]:
    """Return the sizes (n, q) of errors by a unit step in each direction, and the weights (q,) of these."""
    nodes, node_weights = np.polynomial.legendre.leggauss(8)  # here, as numpy.polynomial is slow to import
    along = (nodes + 1) / 2  # of the unit step, on the axis of the largest error
    about = (np.arange(TURNS) + 0.5) / TURNS * np.pi / 2
    variances = np.zeros((len(S), 3))
    variances[:, : S.shape[-1]] = np.maximum(np.linalg.eigvalsh(S)[:, ::-1], 0.0)
    across = 1 - along[:, None] ** 2
    squares = np.stack([along[:, None] ** 2 + 0 * about, across * np.cos(about) ** 2, across * np.sin(about) ** 2])
    weights = np.repeat(node_weights / 2 / TURNS, TURNS)
    return np.sqrt(variances @ squares.reshape(3, -1)), weights
