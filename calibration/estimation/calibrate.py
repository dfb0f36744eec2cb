"""Calibrate a dataset: from its labels to transforms, their covariances, and warnings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.dataset.model import Dataset
from calibration.errors import InputError, UndeterminedError, solvable
from calibration.estimation.blocks import Pose, Values
from calibration.estimation.build import Setup, build
from calibration.estimation.calibrated import (
    calibrated_dataset,
    calibrated_intrinsics,
    calibrated_joints,
    covariances_of_transforms,
    rejected_labels,
    transforms_of,
    view_residuals,
)
from calibration.estimation.error_bars import ErrorBars, error_bars
from calibration.estimation.false_minima import why_false, why_invalid, why_not_reached
from calibration.estimation.flipped_patterns import unflipped
from calibration.estimation.holding import held_blocks
from calibration.estimation.initial_values import initial_values
from calibration.estimation.least_squares import Optimum, Termination, minimise
from calibration.estimation.linear_start import LinearStart, free_patterns, linear_start, pattern_poses
from calibration.estimation.noise_levels import NoiseLevels, estimate_scales
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.observability import WeakDirection, considered_covariance, open_directions
from calibration.estimation.optimisation import HUBER, WeightedOptimum, optimise
from calibration.estimation.options import Options as Options
from calibration.estimation.result import Calibration, Solution
from calibration.estimation.starting_noise import StartingNoise, perturb
from calibration.estimation.suspects import explains_all
from calibration.estimation.unknown_intrinsics import contradicted_priors
from calibration.estimation.wrong_views import without, wrong_views
from calibration.frozen import frozen

FLIP_ROUNDS = 3
TRIAL = Termination(decrease=1e-3, iterations=300)
"""Enough if the optimum explains all views; wrong views make the convergence slow."""


def calibrate(
    dataset: Dataset, options: Options | None = None, noise: StartingNoise | None = None, setup: Setup | None = None
) -> Calibration:
    """Calibrate the sensors of a dataset.

    Args:
        dataset: the labels, and transforms that serve as the initial guess. It is not changed.
        options: options of the calibration.
        noise: noise that is added to the initial guess.
        setup: that of the dataset and the options (`setup_of`), which does not depend on the noise nor on `start` and
            `loss`: for calibrations from many initial guesses.

    Raises:
        UndeterminedError: the data do not determine the parameters; the message names what is missing.
        InputError: the labels cannot be used.
    """
    with solvable(dataset.path):
        try:
            return _calibrate_what_is_determined(dataset, options or Options(), noise or StartingNoise(), setup)
        except UndeterminedError as error:
            if not dataset.missing_files:
                raise
            missing = "; ".join(map(dataset.missing_files_of, dataset.missing_files))
            raise UndeterminedError(f"{error}; {missing}") from error


def setup_of(dataset: Dataset, options: Options) -> Setup:
    """Return the problem of a dataset with some options.

    Raises:
        InputError: as `calibration.estimation.build.build`.
        UndeterminedError: likewise.
    """
    return build(dataset, options.hold, options.intrinsics, options.known_intrinsics())


def _calibrate_what_is_determined(
    dataset: Dataset, options: Options, noise: StartingNoise, setup: Setup | None
) -> Calibration:
    """Calibrate; if the robot's motion is insufficient for that, calibrate the sensors relative to each other."""
    try:
        return _calibrate(dataset, options, noise, setup)
    except UndeterminedError as error:
        if (relative := _relative(dataset, options, noise)) is None:
            raise
        why = str(error).removeprefix(f"{dataset.path}: ")
        return replace(relative, not_determined=why)


def _relative(dataset: Dataset, options: Options, noise: StartingNoise) -> Calibration | None:
    """Calibrate the sensors that see a fixed pattern together, with the pattern's pose free in each collection.

    Then nothing depends on the motion of the robot between collections, and the poses of the sensors on the robot
    are not determined. None if there are no such sensors, or their relative poses are not determined either.
    """
    fixed = [name for name, pattern in dataset.patterns.items() if pattern.fixed]
    if len(dataset.sensors) < 2 or not fixed or set(fixed) & set(options.hold):
        return None
    patterns = {name: replace(pattern, fixed=False) for name, pattern in dataset.patterns.items()}
    try:
        found = _calibrate(replace(dataset, patterns=patterns), options, noise)
    except InputError:
        return None
    return found if found.converged and found.gauge else None


def _calibrate(dataset: Dataset, options: Options, noise: StartingNoise, setup: Setup | None = None) -> Calibration:
    started = _started(setup or setup_of(dataset, options), noise)
    dropped = wrong_views(started.setup, started.linear.values)
    if not dropped:
        return _solved(dataset, started, options)
    if (whole := _explained(dataset, started, options)) is not None:
        return whole
    try:
        rest = _started(setup_of(without(dataset, dropped), options), noise)
        return replace(_solved(dataset, rest, options), dropped_views=dropped)
    except UndeterminedError as error:
        views = ", ".join(dict.fromkeys(view.collection for view in dropped))
        raise UndeterminedError(f"{error} (left out, as their views contradict the others: {views})") from error


def _explained(dataset: Dataset, started: "_Started", options: Options) -> Calibration | None:
    """Calibrate with all views, if an error of a fixed parameter explains their contradictions; else None."""
    problem, start = started.setup.problem, started.linear
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scales = estimate_scales(problem, start.values, {}, robust=True)
        trial = minimise(problem, start.values, Weighting(scales, HUBER), TRIAL)
    if not trial.reached:  # other weights would not help, after many iterations
        return None
    try:
        whole = _solved(dataset, replace(started, linear=replace(start, values=trial.values)), options)
    except UndeterminedError:
        return None
    return whole if whole.converged and explains_all(whole.solution.model) else None


@frozen(eq=False)
class _Started:
    """Problem with its initial values."""

    setup: Setup
    exact: Values
    """By the dataset."""
    guess: Values
    """The same with noise."""
    linear: LinearStart


def _started(setup: Setup, noise: StartingNoise) -> _Started:
    exact = initial_values(setup)
    guess = perturb(setup, exact, noise)
    return _Started(setup, exact, guess, linear_start(setup, guess))


class _OpenCoefficientsError(UndeterminedError):
    """The labels do not determine some distortion coefficients, which can be fixed."""

    def __init__(self, message: str, hold: Sequence[str]) -> None:
        super().__init__(message)
        self.hold = tuple(dict.fromkeys(hold))
        """By their names, such as "intrinsics-left-k6"."""


def _solved(dataset: Dataset, started: _Started, options: Options) -> Calibration:
    """Calibrate from initial values; distortion coefficients that are not determined are fixed, with a note."""
    try:
        return _solved_for_all(dataset, started, options)
    except _OpenCoefficientsError as error:
        found = _solved(dataset, _holding(started, error.hold), options)
        names = ", ".join(f"'{name}'" for name in error.hold)
        note = f"the labels do not determine {names} beside the others: held at what the dataset says"
        return replace(found, notes=(note, *found.notes))


def _holding(started: _Started, names: Sequence[str]) -> _Started:
    """Return the same initial values with some distortion coefficients fixed at their nominal values."""
    setup, problem = started.setup, started.setup.problem
    blocks = held_blocks(setup.dataset, problem.blocks, names)
    values = list(started.linear.values)
    for i, (before, now) in enumerate(zip(problem.blocks, blocks, strict=True)):
        if before.intrinsics and now.intrinsics and before is not now:
            held = [k for k in before.intrinsics.at if now.held or k not in now.intrinsics.at]
            values[i] = values[i].copy()
            values[i][held] = before.intrinsics.camera.intrinsics[held]
    setup = replace(setup, problem=replace(problem, blocks=blocks))
    return replace(started, setup=setup, linear=replace(started.linear, values=tuple(values)))


def _solved_for_all(dataset: Dataset, started: _Started, options: Options) -> Calibration:
    setup, start = started.setup, started.linear
    robust = options.loss == "huber"
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if options.start == "linear":
            result, reason = _from_linear_start(setup, start.values, options)
        else:
            # as in ATOM: the patterns' poses are those from the guess without noise
            seen_from_guess = pattern_poses(setup, started.exact)
            patterns = free_patterns(setup)
            values = tuple(seen_from_guess[i] if i in patterns else T for i, T in enumerate(started.guess))
            result = optimise(setup.problem, values, options.known_noise(), robust)
            reason = why_false(setup, result, start.values)
    return _result(dataset, started, result, reason, options)


def _from_linear_start(setup: Setup, start: Values, options: Options) -> tuple[WeightedOptimum, str]:
    """Optimise from the linear initial guess, or return the reason of a failure; flipped patterns are corrected."""
    result = optimise(setup.problem, start, options.known_noise(), options.loss == "huber")
    for _ in range(FLIP_ROUNDS):
        if reason := why_not_reached(setup, result):
            return result, reason
        optimum = result.optimum
        values, flipped = unflipped(setup.problem, optimum.values, result.weighting, optimum.equations.cost)
        if not flipped.any():
            return result, ""
        result = optimise(setup.problem, values, options.known_noise(), options.loss == "huber")
    return result, why_invalid(setup, result)


def _result(dataset: Dataset, started: _Started, result: WeightedOptimum, reason: str, options: Options) -> Calibration:
    """Return the result at an optimum, with its error bars unless there is a reason why it is not the calibration."""
    setup, optimum, weighting = started.setup, result.optimum, result.weighting
    values = optimum.values
    solution = Solution(setup, values, weighting, calibrated_dataset(setup, values, setup.dataset), options.assume)
    weak = () if reason else _weak_directions(setup, optimum)
    bars = None if reason else _error_bars(solution)
    total, labels = (bars.total, bars.labels) if bars else ({}, {})
    residuals = view_residuals(setup, values)
    return Calibration(
        dataset=solution.dataset if setup.dataset is dataset else calibrated_dataset(setup, values, dataset),
        solution=solution,
        transforms=transforms_of(setup, values),
        covariances=covariances_of_transforms(setup, total),
        label_covariances=covariances_of_transforms(setup, labels),
        error_bars=bars,
        converged=not reason,
        reason=reason,
        cost=optimum.cost,
        degrees_of_freedom=setup.problem.residuals - round(sum(result.parameters.values())),
        iterations=optimum.iterations,
        noise_levels=NoiseLevels(**{str(kind): scale for kind, scale in weighting.scales.items()}),
        residuals=residuals,
        rejected=rejected_labels(setup.dataset, residuals, weighting),
        weak_directions=weak,
        warnings=() if reason else tuple(contradicted_priors(setup.problem.blocks, values)),
        notes=(*setup.ignored, *_notes(started)),
        gauge=setup.gauge,
        joints=calibrated_joints(setup, values, total, labels),
        intrinsics=calibrated_intrinsics(setup, values, total),
    )


def _weak_directions(setup: Setup, optimum: Optimum) -> tuple[str, ...]:
    """Return the directions that the data hardly determine, in words.

    Raises:
        UndeterminedError: the data do not determine some at all.
    """
    problem = setup.problem
    names = [block.name for block in problem.blocks]
    size = max(pattern.size for pattern in setup.dataset.patterns.values())
    undetermined, weak = open_directions(problem, optimum.equations, size)
    if undetermined:
        named = "; ".join(direction.describe(names) for direction in undetermined[:3])
        message = (
            f"{setup.dataset.path}: the labels do not determine {named}; "
            f"add collections with other rotations of the pattern or the robot{_to_hold(setup, undetermined, names)}"
        )
        coefficients = [f"{names[each.block]}-{name}" for each in undetermined for name in each.coefficients_to_hold()]
        raise _OpenCoefficientsError(message, coefficients) if coefficients else UndeterminedError(message)
    return tuple(direction.describe(names) for direction in weak)


def _to_hold(setup: Setup, undetermined: Sequence[WeakDirection], names: Sequence[str]) -> str:
    """Return the advice to fix a parameter, for a message; empty if there is only one transform to calibrate."""
    problem = setup.problem
    if not setup.dataset.additional_transforms and not any(problem.blocks[i].parameters.free for i in problem.shared):
        return ""
    name = next((name for each in undetermined if (name := each.to_hold(names))), "")
    return f", or hold one of them{f', such as {name!r}' if name else ''}"


def _error_bars(solution: Solution) -> ErrorBars:
    problem = solution.setup.problem
    considered = considered_covariance(problem, solution.values, solution.weighting)
    at = problem.shared_parameters
    poses = [block for block in at if isinstance(problem.blocks[block].parameters, Pose)]
    return error_bars(solution.model, at, poses, considered)


def _notes(started: _Started) -> list[str]:
    """Return what was taken from the guess, in words."""
    guessed = [
        f"no equation gives '{name}' a linear start; it starts from its guess" for name in started.linear.guessed
    ]
    return guessed + [
        f"pattern '{name}' is held where the guess puts it: only poses relative to it can be known"
        for name in started.setup.gauge_patterns
    ]
