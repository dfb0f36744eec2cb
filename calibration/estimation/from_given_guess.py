"""Calibration from the given guess, as other software starts, judged by that from the linear initial guess."""

from dataclasses import replace

import numpy as np

from calibration.dataset.model import Dataset
from calibration.estimation.at_optimum import calibration_at
from calibration.estimation.blocks import Values
from calibration.estimation.build import Setup
from calibration.estimation.false_minima import why_invalid, why_not_reached
from calibration.estimation.initial_values import initial_values
from calibration.estimation.linear_start import free_patterns, pattern_poses
from calibration.estimation.normal_equations import assemble
from calibration.estimation.optimisation import WeightedOptimum, optimise
from calibration.estimation.options import Options
from calibration.estimation.result import Calibration, Solution
from calibration.estimation.starting_noise import StartingNoise, perturb

SAME_COST = 0.01
"""Difference of the costs of two optima that are the same: a tenth of a standard deviation. Points at a pattern's
corner, which may count for either of its edges, make minima beside each other that differ by less."""
NEAR, NEAR_RELATIVE = 1e-4, 1e-6
"""m, rad or px, and relative: distance of their values. One that is mirrored may have the same cost, not the values."""


def from_given_guess(dataset: Dataset, linear: Calibration, noise: StartingNoise, options: Options) -> Calibration:
    """Calibrate from the dataset's own transforms with noise.

    The optimum of the same labels does not depend on the start. So a minimisation that ends at the optimum from the
    linear initial guess has the same calibration, to the last bit; its own are only its iterations.

    Args:
        dataset: the calibrated dataset.
        linear: its calibration from the linear initial guess.
        noise: noise of the guess.
        options: options of the calibration.

    Raises:
        UndeterminedError: the labels do not determine some directions at an optimum elsewhere.
    """
    reference = linear.solution
    setup = reference.setup
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        result = optimise(setup.problem, _guess(setup, noise), options.known_noise(), options.loss == "huber")
        reason = why_not_reached(setup, result)
        if not reason:
            known = assemble(setup.problem, reference.values, result.weighting).total
            if _same(result, reference, known):
                return replace(linear, iterations=result.optimum.iterations)
            reason = why_invalid(setup, result) or _why_worse(result.optimum.cost, known)
    return replace(
        calibration_at(dataset, setup, result, reason, options, linear.notes), dropped_views=linear.dropped_views
    )


def _guess(setup: Setup, noise: StartingNoise) -> Values:
    """Return the noisy guess of all blocks; as in ATOM, the patterns' poses are those from the guess without noise."""
    exact = initial_values(setup)
    seen, patterns = pattern_poses(setup, exact), free_patterns(setup)
    return tuple(seen[i] if i in patterns else T for i, T in enumerate(perturb(setup, exact, noise)))


def _same(result: WeightedOptimum, reference: Solution, known: float) -> bool:
    """Whether an optimum is that of the reference, whose cost with the same weights is known."""
    cost = result.optimum.cost
    return abs(cost - known) <= SAME_COST and all(
        np.allclose(a, b, rtol=NEAR_RELATIVE, atol=NEAR)
        for a, b in zip(result.optimum.values, reference.values, strict=True)
    )


def _why_worse(cost: float, known: float) -> str:
    """Return the reason why an optimum is not the calibration if a lower cost is known; else empty."""
    if known < cost * (1 - 1e-6) - 1e-6:
        return f"a false minimum: cost {cost:.6g}, while {known:.6g} can be reached"
    return ""
