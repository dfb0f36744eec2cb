"""Calibration from the given guess, as other software starts, judged by that from the linear initial guess."""

from dataclasses import replace

import numpy as np

from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.at_optimum import calibration_at
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.doubts.false_minima import why_invalid, why_not_reached
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.solve.least_squares import Evaluation
from calibration.engine.estimation.solve.normal_equations import assemble
from calibration.engine.estimation.solve.optimisation import optimise
from calibration.engine.estimation.solve.options import Options

SAME_COST = 0.01
"""Largest difference of the costs of two optima that are the same: a tenth of a standard deviation. Points at a
pattern's corner, which may count for either of its edges, make minima beside each other that differ by less."""
NEAR, NEAR_RELATIVE = 1e-4, 1e-6
"""Largest difference of their values, in m, rad or px, and relative. A mirrored optimum may have the same cost, but has
other values."""


def from_given_guess(dataset: Dataset, linear: Calibration, guess: Values, options: Options) -> Calibration:
    """Calibrate from a guess.

    The optimum of the same labels does not depend on the start. So a minimisation that ends at the optimum from the
    linear initial guess returns that calibration, to the last bit; only the number of iterations is its own.

    Args:
        dataset: the calibrated dataset.
        linear: its calibration from the linear initial guess.
        guess: values of all blocks of its problem.
        options: options of the calibration.

    Raises:
        UndeterminedError: the labels do not determine some directions at an optimum elsewhere.
    """
    known = linear.solution
    problem = known.setup.problem

    def arrived(now: Evaluation) -> bool:
        return _near(now.values, known.values) and abs(now.cost(known.weighting) - linear.cost) <= SAME_COST

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        result = optimise(problem, guess, options.known_noise(), options.loss == "huber", arrived)
        reason = why_not_reached(known.setup, result)
        if not reason:
            cost, lower = result.optimum.cost, assemble(problem, known.values, result.weighting).total
            if _near(result.optimum.values, known.values) and abs(cost - lower) <= SAME_COST:
                return replace(linear, iterations=result.optimum.iterations)
            reason = why_invalid(known.setup, result) or _why_worse(cost, lower)
    found = calibration_at(dataset, known.setup, result, reason, options, linear.notes)
    return replace(found, dropped_views=linear.dropped_views)


def _near(values: Values, known: Values) -> bool:
    """Whether the values of all blocks are within `NEAR`, or `NEAR_RELATIVE`, of those of a known optimum."""
    return all(np.allclose(a, b, rtol=NEAR_RELATIVE, atol=NEAR) for a, b in zip(values, known, strict=True))


def _why_worse(cost: float, lower: float) -> str:
    """Return the reason why an optimum is not the calibration if a lower cost is known; else empty."""
    if lower < cost * (1 - 1e-6) - 1e-6:
        return f"a false minimum: cost {cost:.6g}, while {lower:.6g} can be reached"
    return ""
