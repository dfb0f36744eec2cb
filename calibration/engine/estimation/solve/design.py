"""Choice of the collections that determine a calibration best: poses of a motion, or moments of a recording.

Greedy A-optimal design: the next one minimises the sum of the calibrated parameters' variances, the trace of their
covariance (F. Pukelsheim, "Optimal design of experiments", 1993).
"""

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.problem.batches import table_of
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.solve.normal_equations import Weighting, linearise

PRIOR_SIGMA = 0.1
"""Prior standard deviation before the first pose, so that there is a covariance from the start;
in rad and in the unit of length.
"""
_DIGITS_OF_SCORE = 6  # of a score: smaller differences are rounding errors, and the first of equal ones is taken


def choose(
    information: Array, parameters: int, partial: Array, share: float, cells: BoolArray, count: int
) -> list[int]:
    """Return the indices of the best poses, in order of choice, at most ``count``.

    The next pose is the best among those with partial views or those without, as the share of partial
    views so far requires; and among those that show the pattern in new places, while there are any.

    Args:
        information: (N, D, D), information of each pose on D parameters, in comparable units.
        parameters: number of the D that are calibrated; the others, after them, are marginalised.
        partial: (N,), the share of each pose's views that are partial.
        share: the required share of all.
        cells: (N, C), mask of the places in which each pose shows the pattern.
        count: number of poses.
    """
    chosen: list[int] = []
    in_part = partial > 0
    left = np.ones(len(information), bool)
    shown = np.zeros(cells.shape[1], bool)
    known = np.eye(information.shape[-1]) / PRIOR_SIGMA**2
    while len(chosen) < count and left.any():
        wanted_in_part = bool(partial[chosen].sum() < share * len(chosen))
        pool = _narrow_pool(left, in_part == wanted_in_part)
        pool = _narrow_pool(pool, np.any(cells & ~shown, axis=-1))
        index = np.flatnonzero(pool)
        best = int(index[_sum_of_variances(known + information[index], parameters).argmin()])
        chosen.append(best)
        left[best] = False
        shown |= cells[best]
        known = known + information[best]
    return chosen


def _narrow_pool(pool: BoolArray, wish: BoolArray) -> BoolArray:
    """Restrict a pool (N,) to those that fulfil a wish (N,); unchanged if none does."""
    some: BoolArray = pool & wish
    return some if some.any() else pool


def _sum_of_variances(information: Array, parameters: int) -> Array:
    """Return the sum of the variances (N,) of the first parameters, rounded so that machines agree."""
    variance = np.linalg.inv(information).diagonal(axis1=1, axis2=2)[:, :parameters].sum(-1)
    unit = 10.0 ** (np.floor(np.log10(variance)) + 1 - _DIGITS_OF_SCORE)
    rounded: Array = np.round(variance / unit) * unit
    return rounded


def informations(problem: Problem, values: Values, weighting: Weighting) -> Array:
    """Return the information (N, S, S) of each collection on the S shared parameters, with its local ones eliminated.

    Their sum is `calibration.engine.estimation.solve.normal_equations.NormalEquations.schur`.
    """
    S, P = problem.sizes
    H = np.zeros((problem.collections, S + P, S + P))
    table = table_of(problem.blocks, values)
    for batch in problem.batches:
        T, A = batch.linearise(table, values)
        _, M, _ = linearise(batch.terms, T, weighting)
        J = np.concatenate(batch.spread(A, problem.sizes, problem.intrinsics_at(batch)), -1)
        np.add.at(H, batch.collections, np.swapaxes(J, 1, 2) @ M @ J)
    H_local, H_mixed = H[:, S:, S:], H[:, :S, S:]
    index = np.arange(H_local.shape[-1])
    H_local[:, index, index] += H_local[:, index, index] == 0  # no view depends on it, so it has no effect
    reduced: Array = H[:, :S, :S] - H_mixed @ np.linalg.solve(H_local, np.swapaxes(H_mixed, 1, 2))
    return 0.5 * (reduced + np.swapaxes(reduced, 1, 2))
