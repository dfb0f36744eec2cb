"""Calibrate a dataset: from its labels to transforms, their covariances, and warnings.

A calibration is `solve(prepare(dataset, options), noise)`: what many calibrations of a dataset share, decided once, and
one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import InputError, UndeterminedError, solvable
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.at_optimum import calibration_at, from_linear_start, why_invalid, why_not_reached
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from calibration.engine.estimation.covariance.suspects import explains_all
from calibration.engine.estimation.least_squares.minimisation import (
    HUBER_THRESHOLD,
    Evaluation,
    Termination,
    minimise,
    optimise,
)
from calibration.engine.estimation.least_squares.noise_levels import estimate_scales
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.options import Options as Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.scale_and_lags import better_scale, unknown_scale, with_scale_and_lags, wrong_scale
from calibration.engine.estimation.start.ambiguous_views import with_boards_turned_back
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.guesses import (
    StartingNoise,
    guess_of_dataset,
    guess_with_patterns,
    perturb,
    problem_and_start,
)
from calibration.engine.estimation.start.lens_choice import with_chosen_lenses
from calibration.engine.estimation.start.linear_start import LinearStart, linear_start
from calibration.engine.estimation.start.wrong_views import without, wrong_views

TERMINATION_OF_TRIAL = Termination(decrease=1e-3, iterations=300)
"""Enough if the optimum explains all views; wrong views make the convergence slow."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """Problem of a dataset, its linear start, and the calibration from there."""

    dataset: Dataset
    """The calibrated dataset: with boards turned back, and the scale of measured poses and the lags that were found."""
    options: Options
    setup: Setup
    """Problem, without the views that contradict the others."""
    start: LinearStart
    """Initial values from the labels; what these leave open is that of the dataset, without noise."""
    optimum: Calibration
    """Calibration from that start: that from all other starts which do not differ from it, or arrive at the same."""

    @cached_property
    def guess(self) -> Values:
        """Values by the dataset's own transforms, of the blocks that the optimum has: what is held there is held.

        Raises:
            InputError: no camera sees a fixed pattern.
        """
        return guess_with_patterns(self.optimum.solution.setup)


def prepare(dataset: Dataset, options: Options) -> Prepared:
    """Decide all that does not depend on the noise of an initial guess.

    1. Views of a board that were numbered from its other end than most are turned back.
    2. A free scale of measured poses, and free lags of sensors, are found.
    3. The problem is built, and a start found by linear algebra.
    4. Views that contradict the majority of the others are left out of the problem.
    5. It is solved from its linear start. If the robot's motion is insufficient for that, the sensors are calibrated
       relative to each other.

    Args:
        dataset: the labels, and transforms that serve as the initial guess. It is not changed.
        options: options of all its calibrations.

    Raises:
        UndeterminedError: the data do not determine the parameters; the message names what is missing.
        InputError: the labels cannot be used.
    """
    with solvable(dataset.path):
        dataset, turned = with_boards_turned_back(dataset)
        dataset = with_scale_and_lags(dataset, options)
        try:
            prepared = _prepare_what_is_determined(dataset, options)
        except UndeterminedError as error:
            if (factor := wrong_scale(dataset, options)) is not None:
                raise unknown_scale(dataset, factor) from error
            if not dataset.missing_files:
                raise
            missing = "; ".join(map(dataset.missing_files_of, dataset.missing_files))
            raise UndeterminedError(f"{error}; {missing}") from error
        if (factor := better_scale(dataset, options, prepared.optimum)) is not None:
            raise unknown_scale(dataset, factor)
        return replace(prepared, optimum=replace(prepared.optimum, turned_views=turned)) if turned else prepared


def prepare_without(prepared: Prepared, dropped: tuple[DroppedView, ...]) -> Prepared:
    """Prepare the same dataset without the labels of some views, which its calibrations have as dropped ones.

    Raises:
        UndeterminedError: the other views do not determine the parameters.
    """
    with solvable(prepared.dataset.path):
        rest = _prepare_rest(prepared.dataset, prepared.options, dropped)
        return replace(rest, optimum=replace(rest.optimum, turned_views=prepared.optimum.turned_views))


def _prepare_what_is_determined(dataset: Dataset, options: Options) -> Prepared:
    """Prepare the whole problem; if the robot's motion is insufficient for that, the sensors relative to each other."""
    try:
        return _prepare_problem(dataset, options)
    except UndeterminedError as error:
        if (relative := _prepare_relative_poses(dataset, options)) is None:
            raise
        why = str(error).removeprefix(f"{dataset.path}: ")
        return replace(relative, optimum=replace(relative.optimum, not_determined=why))


def _prepare_relative_poses(dataset: Dataset, options: Options) -> Prepared | None:
    """Prepare with the pose of each fixed pattern free in each collection; None if that determines nothing either.

    Then nothing depends on the motion of the robot between collections, and the poses of the sensors on the robot
    are not determined. Only sensors that see a pattern together have a relative pose.
    """
    fixed = {name for name, pattern in dataset.patterns.items() if pattern.fixed}
    if len(dataset.sensors) < 2 or not fixed or fixed & set(options.hold):
        return None
    patterns = {name: replace(pattern, fixed=False) for name, pattern in dataset.patterns.items()}
    try:
        prepared = _prepare_problem(replace(dataset, patterns=patterns), options)
    except InputError:
        return None
    return prepared if prepared.optimum.converged and prepared.optimum.gauge else None


def _prepare_problem(dataset: Dataset, options: Options) -> Prepared:
    """Build the problem, without views that contradict the others, and solve it from its linear start.

    Raises:
        UndeterminedError: the labels do not determine all parameters.
    """
    setup, start = problem_and_start(dataset, options)
    wrong = wrong_views(setup, start.values, options.assume)
    if not wrong:
        return Prepared(dataset, options, setup, start, from_linear_start(dataset, setup, start, options))
    if explained := _explained_by_fixed_parameter(dataset, setup, start, options):
        return Prepared(dataset, options, setup, start, explained)
    try:
        return _prepare_rest(dataset, options, wrong)
    except UndeterminedError as error:
        raise _naming_views_left_out(error, wrong) from error


def _prepare_rest(dataset: Dataset, options: Options, dropped: tuple[DroppedView, ...]) -> Prepared:
    """Build the problem without some views, and solve it from its linear start."""
    setup, start = problem_and_start(without(dataset, dropped), options)
    optimum = from_linear_start(dataset, setup, start, options)
    return Prepared(dataset, options, setup, start, replace(optimum, dropped_views=dropped))


def _explained_by_fixed_parameter(
    dataset: Dataset, setup: Setup, start: LinearStart, options: Options
) -> Calibration | None:
    """Calibrate with all views, if an error of a fixed parameter explains their contradictions; else None."""
    problem = setup.problem
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scales = estimate_scales(problem, start.values, {}, robust=True)
        trial = minimise(problem, start.values, Weighting(scales, HUBER_THRESHOLD), TERMINATION_OF_TRIAL)
    if not trial.reached:  # other weights would not help, after many iterations
        return None
    try:
        whole = from_linear_start(dataset, setup, replace(start, values=trial.values), options)
    except UndeterminedError:
        return None
    return whole if whole.converged and explains_all(whole.solution.model) else None


def _naming_views_left_out(error: UndeterminedError, wrong: Sequence[DroppedView]) -> UndeterminedError:
    """Return an error that names the collections with rejected views."""
    views = ", ".join(dict.fromkeys(view.collection for view in wrong))
    return UndeterminedError(f"{error} (left out, as their views contradict the others: {views})")


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
