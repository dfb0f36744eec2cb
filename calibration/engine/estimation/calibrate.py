"""Calibrate a dataset: from its labels to transforms, their covariances, and warnings.

A calibration is `solve(prepare(dataset, options), noise)`: what many calibrations of a dataset share, and one of them.
"""

from dataclasses import replace

import numpy as np

from calibration.base import solvable
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.at_optimum import calibration_at, why_invalid, why_not_reached
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.from_linear_start import from_linear_start
from calibration.engine.estimation.least_squares.minimisation import Evaluation
from calibration.engine.estimation.least_squares.normal_equations import assemble
from calibration.engine.estimation.least_squares.optimisation import optimise
from calibration.engine.estimation.options import Options as Options
from calibration.engine.estimation.prepare import Prepared, prepare
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.guesses import StartingNoise, guess_of_dataset, perturb
from calibration.engine.estimation.start.lens_choice import with_chosen_lenses
from calibration.engine.estimation.start.linear_start import linear_start

MAX_COST_DIFFERENCE = 0.01
"""Largest difference of the costs of two optima that are the same: a tenth of a standard deviation. Points at a
pattern's corner, which may count for either of its edges, make minima beside each other that differ by less."""
MAX_VALUE_DIFFERENCE, MAX_RELATIVE_VALUE_DIFFERENCE = 1e-4, 1e-6
"""Largest difference of their values, in m, rad or px, and relative. A mirrored optimum may have the same cost, but has
other values."""


def calibrate(dataset: Dataset, options: Options | None = None, noise: StartingNoise | None = None) -> Calibration:
    """Calibrate the sensors of a dataset.

    Args:
        dataset: the labels, and transforms that serve as the initial guess. It is not changed.
        options: options of the calibration.
        noise: noise that is added to the initial guess.

    Raises:
        UndeterminedError: the data do not determine the parameters; the message names what is missing.
        InputError: the labels cannot be used, or no lens fits as ``options.lens`` says.
    """
    options = options or Options()
    if options.lens:
        dataset = with_chosen_lenses(dataset, options).dataset
    return solve(prepare(dataset, options), noise or StartingNoise())


def solve(prepared: Prepared, noise: StartingNoise) -> Calibration:
    """Calibrate from the initial guess with noise.

    - From the given guess (``start: given``) the least squares begin at the noisy guess; if they end at the prepared
      optimum, that is the result.
    - From a linear start, noise changes only what the labels leave open. If that is nothing, or there is no noise, the
      result is the prepared optimum itself.

    Raises:
        UndeterminedError: the labels do not determine some directions at an optimum elsewhere.
        InputError: no camera sees a fixed pattern, so it has no place in the given guess.
    """
    optimum = prepared.optimum
    with solvable(prepared.dataset.path):
        if prepared.options.start == "given":
            found = solve_from_guess(prepared, perturb(optimum.solution.setup, prepared.guess, noise))
        elif prepared.start.depends_on_guess and not noise.is_zero:
            setup = prepared.setup
            start = linear_start(setup, perturb(setup, guess_of_dataset(setup), noise))
            found = from_linear_start(prepared.dataset, setup, start, prepared.options)
        else:
            return optimum
    return replace(
        found,
        dropped_views=optimum.dropped_views,
        turned_views=optimum.turned_views,
        not_determined=optimum.not_determined,
    )


def solve_from_guess(prepared: Prepared, guess: Values) -> Calibration:
    """Calibrate from a guess.

    The optimum of the same labels does not depend on the start. So a minimisation that ends at the optimum from the
    linear start returns that calibration, to the last bit; only the number of iterations is its own.

    Args:
        prepared: the problem, and its optimum from the linear start.
        guess: values of all blocks of that problem.

    Raises:
        UndeterminedError: the labels do not determine some directions at an optimum elsewhere.
    """
    linear, options = prepared.optimum, prepared.options
    known = linear.solution
    problem = known.setup.problem

    def has_arrived(now: Evaluation) -> bool:
        return _are_near(now.values, known.values) and _costs_are_same(now.cost(known.weighting), linear.cost)

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        result = optimise(problem, guess, options.known_noise(), options.loss == "huber", has_arrived)
        reason = why_not_reached(known.setup, result)
        if not reason:
            cost, lower = result.optimum.cost, assemble(problem, known.values, result.weighting).total
            if _are_near(result.optimum.values, known.values) and _costs_are_same(cost, lower):
                return replace(linear, iterations=result.optimum.iterations)
            reason = why_invalid(known.setup, result) or _why_worse(cost, lower)
    return calibration_at(prepared.dataset, known.setup, result, reason, options, linear.notes)


def _are_near(values: Values, known: Values) -> bool:
    """Whether the values of all blocks are those of a known optimum, within the largest differences."""
    return all(
        np.allclose(a, b, rtol=MAX_RELATIVE_VALUE_DIFFERENCE, atol=MAX_VALUE_DIFFERENCE)
        for a, b in zip(values, known, strict=True)
    )


def _costs_are_same(cost: float, other: float) -> bool:
    return abs(cost - other) <= MAX_COST_DIFFERENCE


def _why_worse(cost: float, lower: float) -> str:
    """Return the reason why an optimum is not the calibration if a lower cost is known; else empty."""
    if lower < cost * (1 - 1e-6) - 1e-6:
        return f"a false minimum: cost {cost:.6g}, while {lower:.6g} can be reached"
    return ""
