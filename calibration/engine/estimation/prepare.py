"""Preparation of a dataset's calibrations: all that is decided once, whatever noise the initial guesses have.

The lag of a sensor is the time from a collection's transforms to what it saw. At the optimum for given lags, one Newton
step in all free ones beside all that is calibrated leads to the next. The transforms that a sensor saw are those of the
dataset, moved by their velocities for its lag (`Dataset.moved_by_lag`), so that a step is nearly exact. Their own
uncertainty is in the error bars (`calibration.engine.estimation.covariance.error_bars`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import InputError, UndeterminedError, solvable
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.sensors import MAX_LAG
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND
from calibration.engine.estimation.covariance.linear_model import LinearModel
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from calibration.engine.estimation.covariance.suspects import MIN_INFORMATION_LEFT, explains_all
from calibration.engine.estimation.from_linear_start import from_linear_start
from calibration.engine.estimation.least_squares.minimisation import Termination, minimise
from calibration.engine.estimation.least_squares.noise_levels import estimate_scales
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.least_squares.optimisation import HUBER_THRESHOLD
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.pose_scale import better_scale, unknown_scale, with_free_scale, wrong_scale
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.guesses import guess_with_patterns, problem_and_start
from calibration.engine.estimation.start.linear_start import LinearStart
from calibration.engine.estimation.start.turned_boards import with_boards_turned_back
from calibration.engine.estimation.start.wrong_views import without, wrong_views

MAX_STEP_IF_FOUND = 1e-7
"""s: step after which the lags are found."""
MAX_STEPS = 15
MAX_STEP = 0.1
"""s: limit of one step."""
MAX_SIGMA = 0.05
"""s: limit of the standard deviation of a lag that is determined; frames that stand still leave a larger one."""


def with_lags(dataset: Dataset, free: Sequence[str], calibrated: Callable[[Dataset], Calibration]) -> Dataset:
    """Return the dataset with the lags of some sensors as its labels tell.

    Args:
        dataset: the dataset.
        free: the sensors.
        calibrated: calibrates a dataset with the lags that it has.

    Raises:
        InputError: a sensor is unknown.
        UndeterminedError: the labels do not determine a lag.
    """
    for name in free:
        if name not in dataset.sensors:
            raise InputError(f"{dataset.path}: lag: found sensor '{name}', expected of {', '.join(dataset.sensors)}")
    if not dataset.velocities:
        raise UndeterminedError(
            f"{dataset.path}: the dataset has no velocities, which a lag is told by (lag): import it from a bag of "
            f"a robot that moves while its sensors look (import.yml: bags: every), or leave 'lag' out"
        )
    for _ in range(MAX_STEPS):
        steps = _newton_steps(calibrated(dataset).solution.model, free, dataset)
        lags = {name: dataset.sensors[name].lag + step for name, step in steps.items()}
        if far := next((name for name, lag in lags.items() if abs(lag) > MAX_LAG), None):
            raise UndeterminedError(
                f"{dataset.path}: the lag of '{far}' comes out beyond {MAX_LAG:g} s (lag): are the velocities, and the "
                f"order of the images, those of this recording?"
            )
        dataset = dataset.with_lags(lags)
        if max(map(abs, steps.values())) < MAX_STEP_IF_FOUND:
            return dataset
    raise UndeterminedError(f"{dataset.path}: the lags were not found in {MAX_STEPS} steps (lag): leave it out")


def _newton_steps(model: LinearModel, free: Sequence[str], dataset: Dataset) -> Mapping[str, float]:
    """Return the Newton step of each free lag, s."""
    places = {cause.subject: at.start for cause, at in model.placed(LAG_KIND)}
    if standing := next((name for name in free if name not in places), None):
        raise _undetermined_lag(dataset, standing)
    own = [places[name] for name in free]
    left, gradient = model.beside_shared(own)
    scale = 1 / np.sqrt(model.alone[own])
    values, vectors = np.linalg.eigh(scale[:, None] * left * scale)
    if values[0] <= MIN_INFORMATION_LEFT:
        raise _undetermined_lag(dataset, free[int(np.abs(vectors[:, 0]).argmax())])
    covariance = np.linalg.inv(left)
    sigmas = np.sqrt(np.diagonal(covariance))
    if sigmas.max() > MAX_SIGMA:
        raise _undetermined_lag(dataset, free[int(sigmas.argmax())])
    return dict(zip(free, np.clip(-covariance @ gradient, -MAX_STEP, MAX_STEP).tolist(), strict=True))


def _undetermined_lag(dataset: Dataset, sensor: str) -> UndeterminedError:
    others = [name for name in dataset.sensors if name != sensor]
    one = f", or leave '{others[0]}' the clock: lag: [{sensor}]" if others else ""
    return UndeterminedError(
        f"{dataset.path}: the labels do not determine the lag of '{sensor}' (lag): collect while the robot or the "
        f"pattern moves, in several directions{one}; or leave it out"
    )


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
        dataset = _with_scale_and_lags(dataset, options)
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


def _with_scale_and_lags(dataset: Dataset, options: Options) -> Dataset:
    """Return the dataset with the scale of its measured poses and the lags of its sensors, where they are free."""
    if options.scale == "free":
        dataset, _ = with_free_scale(dataset, options)
    if not (free := options.free_lags_of(dataset)):
        return dataset
    known = replace(options, lag=())  # lags that cannot be told beside each other would have no error bars
    return with_lags(dataset, free, lambda each: from_linear_start(each, *problem_and_start(each, known), known))
