"""Levenberg-Marquardt minimisation over poses, joints and intrinsics, and with noise that matches the residuals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.least_squares.noise_levels import (
    MIN_SIGMA_OF_KIND,
    NoiseLevels,
    estimate_scales,
    scales_of,
)
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Squares, Weighting, assemble
from calibration.engine.estimation.least_squares.observability import determined_parameters
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.views import total_loss

MAX_STEPS_WITHOUT_DECREASE = 20
"""Number of steps without a noticeable decrease after which a minimisation has stalled."""


@dataclass(frozen=True)
class Termination:
    """Termination criteria."""

    decrease: float = 1e-6
    """Predicted decrease of the cost by the next step, in squared standard deviations. With the default
    the last step moves no parameter by more than 1e-3 of its own standard deviation."""
    relative_decrease: float = 1e-14
    """The same relative to the cost: below it rounding errors dominate."""
    stall: float = 0.01
    """Decrease over `MAX_STEPS_WITHOUT_DECREASE` steps below which it ends too: a distant pattern that faces its camera
    hardly determines its own tilt, which could take thousands of steps that change nothing else."""
    iterations: int = 500


@dataclass(frozen=True, eq=False)
class Optimum:
    """Result of a minimisation."""

    values: Values
    equations: NormalEquations
    """Normal equations, undamped, before the last step, which is too small to change them."""
    weighting: Weighting
    """For which it is the optimum."""
    iterations: int
    reached: bool
    """Whether it is a minimum; False if the iterations ran out or the cost was not finite."""

    @property
    def cost(self) -> float:
        """Sum of squared residuals, in standard deviations (Huber's loss if it is robust)."""
        return self.equations.total


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Normal equations at some values, with their residuals."""

    values: Values
    weighting: Weighting
    equations: NormalEquations
    squares: Squares
    """Empty unless they were asked for."""

    def cost(self, weighting: Weighting) -> float:
        """Return the cost with another weighting."""
        if weighting is self.weighting:
            return self.equations.total
        labels = (
            total_loss(part, weighting.scales[kind], weighting.huber)
            for kind, parts in self.squares.items()
            for part in parts
        )
        return sum(labels) + self.equations.prior


Reweigh = Callable[[Evaluation], Weighting]
"""Function that returns the weighting for an evaluation's residuals; the evaluation's own if it is unchanged."""
Arrived = Callable[[Evaluation], bool]
"""Function that returns whether an evaluation is at an optimum that is known already."""


@np.errstate(over="ignore", invalid="ignore")
def minimise(
    problem: Problem,
    values: Values,
    weighting: Weighting,
    until: Termination | None = None,
    reweigh: Reweigh | None = None,
    arrived: Arrived | None = None,
) -> Optimum:
    """Minimise the cost from initial values, by Levenberg-Marquardt.

    The damping follows the gain ratio (H. B. Nielsen, "Damping parameter in Marquardt's method", 1999).
    Each trial is linearised at once: nearly all are accepted, and then nothing is computed twice.

    Weights that depend on the residuals move along: each step is judged by the weights that the residuals before it
    ask for, so that the optimum and its weights are found together.

    Args:
        problem: the problem.
        values: where to start.
        weighting: what residuals weigh, at first.
        until: when to stop.
        reweigh: asked at each point for what residuals are to weigh from there on; they keep their weights if None.
        arrived: asked at each point whether it is at an optimum that is known already, to end there; needs ``reweigh``.
    """
    until = until or Termination()

    def evaluated(at: Values, weighting: Weighting) -> Evaluation:
        squares: Squares = {}
        equations = assemble(problem, at, weighting, squares if reweigh else None)
        return Evaluation(at, weighting, equations, squares)

    def ended(iterations: int, reached: bool, values: Values | None = None) -> Optimum:
        return Optimum(values or now.values, now.equations, now.weighting, iterations, reached)

    now = evaluated(values, weighting)
    damping, growth = 1e-4, 2.0
    costs = [now.equations.total]
    for iteration in range(until.iterations):
        if not np.isfinite(now.equations.total):
            return ended(iteration, reached=False)
        if arrived and arrived(now):
            return ended(iteration, reached=True)
        wanted = reweigh(now) if reweigh else now.weighting
        cost = now.cost(wanted)
        shared, local, predicted = now.equations.step(damping)
        tolerance = max(until.decrease, until.relative_decrease * cost)
        if abs(predicted) <= tolerance:
            if wanted is not now.weighting:
                now = evaluated(problem.moved(now.values, shared, local), wanted)
                continue
            if damping > 1:  # with a large damping every step predicts little: check a longer one
                return ended(iteration + 1, abs(now.equations.step(1.0)[-1]) <= until.stall)
            return ended(iteration + 1, reached=True, values=problem.moved(now.values, shared, local))
        if predicted > 0:  # else rounding has made the system singular or indefinite
            trial = evaluated(problem.moved(now.values, shared, local), wanted)
            gain = min((cost - trial.equations.total) / predicted, 1.0)
            if gain > 1e-4:
                costs = [*costs, trial.equations.total] if wanted is now.weighting else []
                now = trial
                if (
                    len(costs) > MAX_STEPS_WITHOUT_DECREASE
                    and costs[-MAX_STEPS_WITHOUT_DECREASE - 1] - costs[-1] < until.stall
                ):
                    return ended(iteration + 1, reached=True)
                damping, growth = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-12), 2.0
                continue
        if wanted is not now.weighting:  # the step was one for other weights
            now = evaluated(now.values, wanted)
            continue
        damping, growth = damping * growth, growth * 2
        if damping > 1e16:
            return ended(iteration + 1, reached=False)
    return ended(until.iterations, reached=False)


TERMINATION_OF_SETTLING = Termination(decrease=0.01, iterations=20)
"""Enough to compare a collection's costs at two minima."""


def settle(
    problem: Problem,
    values: Values,
    weighting: Weighting,
    which: BoolArray,
    until: Termination = TERMINATION_OF_SETTLING,
    below: Array | None = None,
) -> tuple[Values, Array]:
    """Minimise over the local blocks of some collections (N,), each by itself, with the shared ones fixed.

    Args:
        problem: the problem.
        values: where to start.
        weighting: what residuals weigh.
        which: the collections, (N,).
        until: when to stop.
        below: (N,), costs at which the minima become of interest: a collection is left where it is once decreases
            like its last one would not bring it there in the iterations that remain.

    Returns:
        The values, and the cost (N,) of each collection.
    """
    equations = assemble(problem, values, weighting)
    damping = np.full(problem.collections, 1e-3)
    active = which.copy()
    for remaining in reversed(range(until.iterations)):
        trial = problem.moved(values, np.zeros_like(equations.g_shared), equations.local_step(damping))
        trial = choose(problem, active, trial, values)
        trial_equations = assemble(problem, trial, weighting)
        decrease = equations.cost - trial_equations.cost
        better = active & (decrease >= 0)
        enough = np.maximum(until.decrease, until.relative_decrease * trial_equations.cost)
        values = choose(problem, better, trial, values)
        equations = trial_equations if better[active].all() else assemble(problem, values, weighting)
        damping = np.where(better, damping / 5, damping * 10)
        active &= ~(better & (decrease <= enough)) & (damping < 1e6)
        if below is not None:
            active &= ~better | (equations.cost - below <= remaining * decrease)
        if not active.any():
            break
    return values, equations.cost


def choose(problem: Problem, first: BoolArray, a: Values, b: Values) -> Values:
    """Merge local blocks: of ``a`` where ``first`` (N,) is set, else of ``b``; shared ones of ``a``."""
    out = list(a)
    for block in problem.local:
        out[block] = np.where(first[:, None, None], a[block], b[block])
    return tuple(out)


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
