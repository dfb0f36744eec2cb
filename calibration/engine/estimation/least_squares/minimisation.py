"""Levenberg-Marquardt minimisation over poses, joints and intrinsics."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Squares, Weighting, assemble
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
