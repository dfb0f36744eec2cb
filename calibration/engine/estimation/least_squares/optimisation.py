"""Optimisation from an initial guess: with noise levels that match the residuals."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.least_squares.minimisation import Arrived, Evaluation, Optimum, minimise
from calibration.engine.estimation.least_squares.noise_levels import (
    MIN_SIGMA_OF_KIND,
    NoiseLevels,
    estimate_scales,
    scales_of,
)
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Weighting
from calibration.engine.estimation.least_squares.observability import determined_parameters
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem

HUBER_THRESHOLD = 2.5
"""Threshold of Huber's loss in standard deviations: 4 % of good corners exceed it, which costs about
1 % of accuracy, and the influence of outliers is limited to that at the threshold."""
MAX_CHANGE_IF_SETTLED = 1e-8
"""Relative change of the standard deviations below which the weights have converged."""
NEARLY_SETTLED = 1e-3
"""Relative change at which the parameters that each kind of label determines are counted."""
RECOUNT_AFTER_CHANGES = 1e3
"""The parameters are counted again once the standard deviations have moved, since the last count, by this multiple of
their latest change; so the count, and with it the optimum, does not depend on the start."""
MAX_NEARLY_SETTLED_ROUNDS = 30
"""Number of estimates with nearly settled weights after which the weights stay as they are: they are in a cycle."""
MIN_COLLECTIONS_OF_FIRST_SCALES = 100
"""Least number of collections, if there are as many, from which the first standard deviations are estimated."""


@dataclass(frozen=True, eq=False)
class WeightedOptimum:
    """Optimum, with its weights."""

    optimum: Optimum
    weighting: Weighting
    parameters: Mapping[NoiseKind, float]
    """Number of parameters that each kind of label has determined."""


def optimise(
    problem: Problem, values: Values, levels: NoiseLevels, robust: bool, arrived: Arrived | None = None
) -> WeightedOptimum:
    """Minimise, and estimate the noise from the residuals on the way, until neither changes.

    With plain least squares, one kind of label and nothing known beforehand the weights don't matter and one round
    is enough.

    Args:
        problem: the problem.
        values: where to start.
        levels: standard deviations of the labels that are known.
        robust: whether outliers are to have little effect.
        arrived: whether the minimisation has come to an optimum that is known already, and ends; asked at each point
            while the noise is estimated.
    """
    huber = HUBER_THRESHOLD if robust else None
    kinds = {term.kind for group in problem.groups for term in group.terms}
    given = {kind: level for kind, level in levels.given().items() if kind in kinds}
    if len(kinds) == 1 and not robust and not problem.has_priors:
        return _optimise_plainly(problem, values, {**dict.fromkeys(kinds, 1.0), **given}, estimate=not given)
    some = np.zeros(problem.collections, bool)
    some[:: max(1, problem.collections // MIN_COLLECTIONS_OF_FIRST_SCALES)] = True
    weighting = Weighting({**estimate_scales(problem.seen_in(some), values, {}, robust=True), **given}, huber)
    noise = _Noise(problem, given, robust) if kinds - given.keys() else None
    optimum = minimise(problem, values, weighting, reweigh=noise, arrived=arrived if noise else None)
    parameters = noise.parameters if noise else None
    if not parameters:
        parameters = determined_parameters(problem, optimum.values, optimum.equations, optimum.weighting)
    return WeightedOptimum(optimum, optimum.weighting, parameters)


class _Noise:
    """Standard deviations of labels, estimated at each step of a minimisation from its residuals."""

    def __init__(self, problem: Problem, given: Mapping[NoiseKind, float], robust: bool) -> None:
        """Begin without knowing how many parameters labels determine.

        Args:
            problem: the problem.
            given: standard deviations that are not estimated.
            robust: whether outliers are to be kept out.
        """
        self._problem, self._given, self._robust = problem, given, robust
        self.parameters: Mapping[NoiseKind, float] = {}
        """Number that each kind of label determines; empty until the weights have nearly converged."""
        self._counted_at: Mapping[NoiseKind, float] = {}
        """Standard deviations at which the parameters were counted."""
        self._rounds = 0

    def __call__(self, now: Evaluation) -> Weighting:
        """Return the weighting for the residuals of an evaluation; the evaluation's own if it is unchanged."""
        scales, estimated = now.weighting.scales, self._estimate_scales_at(now)
        change = _largest_change(scales, estimated)
        self._rounds += change < NEARLY_SETTLED
        if change < NEARLY_SETTLED and _largest_change(self._counted_at, scales) > RECOUNT_AFTER_CHANGES * change:
            self.parameters = determined_parameters(self._problem, now.values, now.equations, now.weighting)
            self._counted_at, estimated = scales, self._estimate_scales_at(now)
        if self._rounds > MAX_NEARLY_SETTLED_ROUNDS or _largest_change(scales, estimated) < MAX_CHANGE_IF_SETTLED:
            return now.weighting
        return Weighting(estimated, now.weighting.huber)

    def _estimate_scales_at(self, now: Evaluation) -> dict[NoiseKind, float]:
        return {**scales_of(self._problem, now.squares, self.parameters, self._robust), **self._given}


def _largest_change(before: Mapping[NoiseKind, float], after: Mapping[NoiseKind, float]) -> float:
    """Return the largest relative change of standard deviations; infinite if there were none before."""
    return max((abs(after[kind] / before[kind] - 1) if kind in before else np.inf for kind in after), default=0.0)


def _optimise_plainly(
    problem: Problem, values: Values, scales: dict[NoiseKind, float], estimate: bool
) -> WeightedOptimum:
    """Plain least squares with one kind of label: its standard deviation scales the result afterwards."""
    weighting = Weighting(scales, None)
    optimum = minimise(problem, values, weighting)
    parameters = determined_parameters(problem, optimum.values, optimum.equations, weighting)
    if estimate and np.isfinite(optimum.cost):
        (kind,) = scales
        freedom = max(1.0, problem.residuals - parameters[kind])
        estimated = max(MIN_SIGMA_OF_KIND[kind], scales[kind] * float(np.sqrt(optimum.cost / freedom)))
        weighting = Weighting({kind: estimated}, None)
        equations = _rescale_residuals(optimum.equations, scales[kind] / estimated)
        optimum = replace(optimum, equations=equations, weighting=weighting)
    return WeightedOptimum(optimum, weighting, parameters)


def _rescale_residuals(equations: NormalEquations, factor: float) -> NormalEquations:
    """Return the equations of residuals multiplied by ``factor``, without a pass over the labels."""
    numbers = (getattr(equations, each.name) for each in fields(equations))
    return NormalEquations(*(each * (factor * factor) for each in numbers))
