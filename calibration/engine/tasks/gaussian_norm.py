"""Norm of a Gaussian error: its quantiles, and the probability that it exceeds a limit.

An error ``e ~ N(0, S)`` of three axes is ``e = r s(u)``: a direction u, even over the sphere, a length r with the
distribution F of Maxwell, and the error s(u) by a unit step along u. So ``P(|e| <= x)`` is the mean of
``F(x / |s(u)|)`` over all directions, by Gauss's rule along the axis of the largest error and the midpoint rule about
it. Errors of one or two axes are those of three of which some are zero.
"""

import numpy as np

from calibration.base.arrays import Array

TURNS = 4
"""Directions of a quadrant about the axis."""
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)
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
        slopes = np.where(sizes > 0, _between(lengths, _DENSITY) / sizes, 0.0)
    return _between(lengths, _DISTRIBUTION) @ weights, slopes @ weights


def _between(lengths: Array, values: Array) -> Array:
    """Interpolate values at `_LENGTHS`, the last one beyond them: ten times as fast as by a search."""
    at = np.minimum(lengths / _LENGTHS[1], len(values) - 1)
    low = np.minimum(at.astype(int), len(values) - 2)
    return np.asarray(values[low] + (at - low) * (values[low + 1] - values[low]))


def _sizes_by_direction(S: Array) -> tuple[Array, Array]:
    """Return the sizes (n, q) of errors by a unit step in each direction, and the weights (q,) of these."""
    along = (GAUSS_NODES + 1) / 2  # of the unit step, on the axis of the largest error
    about = (np.arange(TURNS) + 0.5) / TURNS * np.pi / 2
    variances = np.zeros((len(S), 3))
    variances[:, : S.shape[-1]] = np.maximum(np.linalg.eigvalsh(S)[:, ::-1], 0.0)
    across = 1 - along[:, None] ** 2
    squares = np.stack([along[:, None] ** 2 + 0 * about, across * np.cos(about) ** 2, across * np.sin(about) ** 2])
    weights = np.repeat(GAUSS_WEIGHTS / 2 / TURNS, TURNS)
    return np.sqrt(variances @ squares.reshape(3, -1)), weights
