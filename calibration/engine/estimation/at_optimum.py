"""Calibration at an optimum, reached from a linear start: transforms, residuals, error bars; or why it is none."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.base import UndeterminedError
from calibration.base.arrays import BoolArray, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.calibrated import (
    calibrated_dataset,
    calibrated_intrinsics,
    calibrated_joints,
    covariances_of_transforms,
    rejected_labels,
    transforms_of,
    view_residuals,
)
from calibration.engine.estimation.covariance.error_bars import error_bars
from calibration.engine.estimation.covariance.result import CalibratedLag, Calibration, Solution
from calibration.engine.estimation.least_squares.minimisation import Optimum, WeightedOptimum, optimise
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels, with_noise_along_sight
from calibration.engine.estimation.least_squares.observability import WeakDirection, open_directions
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.fixing import held_blocks
from calibration.engine.estimation.problem.intrinsics import contradicted_priors
from calibration.engine.estimation.start.ambiguous_views import unflipped
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.linear_start import LinearStart


def why_not_reached(setup: Setup, result: WeightedOptimum) -> str:
    """Return the reason why no minimum was reached; empty if one was."""
    impossible = np.flatnonzero(~np.isfinite(result.optimum.equations.cost))
    if len(impossible):
        behind = _collections_behind_camera(setup, result.optimum.values)[impossible].any()
        why = "the pattern lies behind a camera" if behind else "labels lie too far off to be compared with the pattern"
        return f"the start is not possible: {why} {_in_collections(setup, impossible)}"
    if not result.optimum.reached:
        return f"no minimum was reached in {result.optimum.iterations} iterations"
    return ""


def _in_collections(setup: Setup, which: IntArray) -> str:
    """Return the collections in words: of more than five their number and the first ones."""
    keys = [setup.dataset.keys[i] for i in which]
    if len(keys) == 1:
        return f"in collection {keys[0]}"
    return f"in {len(keys)} collections ({', '.join(keys[:5])}{', ...' if len(keys) > 5 else ''})"


def _collections_behind_camera(setup: Setup, values: Values) -> BoolArray:
    """Return a mask (N,) of the collections with a corner behind its camera."""
    behind = np.zeros(setup.problem.collections, bool)
    for group in setup.problem.groups:
        for term in setup.problem.terms(group, values):
            magnitudes = term.magnitudes(setup.problem.poses(group, values))
            behind[group.collections] |= np.count_nonzero(~np.isnan(magnitudes), axis=-1) < term.counts
    return behind


def why_invalid(setup: Setup, result: WeightedOptimum) -> str:
    """Return the reason why an optimum is none or has mirrored patterns; empty if it is valid."""
    if reason := why_not_reached(setup, result):
        return reason
    optimum = result.optimum
    _, flipped = unflipped(setup.problem, optimum.values, result.weighting, optimum.equations.cost)
    if flipped.any():
        return f"the pattern is left in its mirrored pose {_in_collections(setup, np.flatnonzero(flipped))}"
    return ""


MORE_ROTATION = "add collections with other rotations of the pattern or the robot"
"""Advice where a transform is not determined,"""
MORE_TILT = "add views in which the pattern is near, and tilted by 30 to 45 degrees"
"""and where intrinsics are not."""


class OpenCoefficientsError(UndeterminedError):
    """The labels do not determine some distortion coefficients, which can be fixed."""

    def __init__(self, message: str, hold: Sequence[str]) -> None:
        super().__init__(message)
        self.hold = tuple(dict.fromkeys(hold))
        """By their names, such as "intrinsics-left-k6"."""


def calibration_at(
    dataset: Dataset,
    setup: Setup,
    result: WeightedOptimum,
    reason: str,
    options: Options,
    notes: Sequence[str],
) -> Calibration:
    """Return the result at an optimum, with its error bars unless there is a reason why it is not the calibration.

    Args:
        dataset: the calibrated dataset; that of the setup has only its used collections.
        setup: the problem.
        result: its optimum.
        reason: why this is not the calibration; empty if it is.
        options: options of the calibration.
        notes: of the problem and the initial values, in words.

    Raises:
        OpenCoefficientsError: the labels do not determine some distortion coefficients.
        UndeterminedError: they do not determine something else.
    """
    optimum, weighting, lags = result.optimum, result.weighting, options.free_lags_of(setup.dataset)
    values = optimum.values
    used = calibrated_dataset(setup, values, setup.dataset)
    solution = Solution(setup, values, weighting, used, options.assume, options.scale == "free", lags)
    weak = () if reason else _weak_directions(setup, optimum)
    bars = None if reason else error_bars(solution.model, setup.problem)
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
        notes=tuple(notes),
        gauge=setup.gauge,
        joints=calibrated_joints(setup, values, total, labels),
        intrinsics=calibrated_intrinsics(setup, values, total),
        lags={
            name: CalibratedLag(setup.dataset.sensors[name].lag, bars.lags.get(name, np.nan) if bars else np.nan)
            for name in lags
        },
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
        of_lenses = all(direction.kind == "ray" for direction in undetermined)
        message = (
            f"{setup.dataset.path}: the labels do not determine {named}; "
            f"{MORE_TILT if of_lenses else MORE_ROTATION}{_to_hold(setup, undetermined, names)}"
        )
        coefficients = [
            f"{names[each.block]}-{name}"
            for each in undetermined
            if (free := problem.blocks[each.block].intrinsics)
            for name in each.coefficients_to_hold(free.camera.distortion)
        ]
        raise OpenCoefficientsError(message, coefficients) if coefficients else UndeterminedError(message)
    return tuple(direction.describe(names) for direction in weak)


def _to_hold(setup: Setup, undetermined: Sequence[WeakDirection], names: Sequence[str]) -> str:
    """Return the advice to fix a parameter, for a message; empty if there is only one transform to calibrate."""
    problem = setup.problem
    if not setup.dataset.additional_transforms and not any(problem.blocks[i].parameters.free for i in problem.shared):
        return ""
    name = next((name for each in undetermined if (name := each.to_hold(names))), "")
    return f", or hold one of them{f', such as {name!r}' if name else ''}"


FLIP_ROUNDS = 3
SIGHT_ROUNDS = 4
"""Estimates of the noise of measured poses along the line of sight, each at the optimum of the one before."""


def from_linear_start(dataset: Dataset, setup: Setup, start: LinearStart, options: Options) -> Calibration:
    """Calibrate; distortion coefficients that are not determined are fixed, with a note.

    Args:
        dataset: the calibrated dataset.
        setup: its problem, or that without some of its views.
        start: initial values of the problem.
        options: options of the calibration.

    Raises:
        UndeterminedError: the labels do not determine something else.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        result, reason = _optimise_unflipped(setup, start, options)
        if not reason:
            setup, result, reason = _with_noise_along_sight(setup, result, options)
    try:
        return calibration_at(dataset, setup, result, reason, options, _notes_on_start(setup, start))
    except OpenCoefficientsError as error:
        found = from_linear_start(dataset, *_with_coefficients_held(setup, start, error.hold), options)
        names = ", ".join(f"'{name}'" for name in error.hold)
        note = f"the labels do not determine {names} beside the others: held at what the dataset says"
        return replace(found, notes=(note, *found.notes))


def _with_coefficients_held(setup: Setup, start: LinearStart, names: Sequence[str]) -> tuple[Setup, LinearStart]:
    """Return the same problem and initial values with some distortion coefficients fixed at their nominal values."""
    problem = setup.problem
    blocks = held_blocks(setup.dataset, problem.blocks, names)
    values = list(start.values)
    for i, (before, now) in enumerate(zip(problem.blocks, blocks, strict=True)):
        if before.intrinsics and now.intrinsics and before is not now:
            held = [k for k in before.intrinsics.at if now.held or k not in now.intrinsics.at]
            values[i] = values[i].copy()
            values[i][held] = before.intrinsics.camera.intrinsics[held]
    return replace(setup, problem=replace(problem, blocks=blocks)), replace(start, values=tuple(values))


def _optimise_unflipped(setup: Setup, start: LinearStart, options: Options) -> tuple[WeightedOptimum, str]:
    """Optimise, or return the reason of a failure; flipped patterns are corrected."""
    robust = options.loss == "huber"
    result = optimise(setup.problem, start.values, options.known_noise(), robust)
    for _ in range(FLIP_ROUNDS):
        if reason := why_not_reached(setup, result):
            return result, reason
        optimum = result.optimum
        values, flipped = unflipped(setup.problem, optimum.values, result.weighting, optimum.equations.cost)
        if not flipped.any():
            return result, ""
        result = optimise(setup.problem, values, options.known_noise(), robust)
    return result, why_invalid(setup, result)


def _with_noise_along_sight(
    setup: Setup, result: WeightedOptimum, options: Options
) -> tuple[Setup, WeightedOptimum, str]:
    """Return the problem with the noise of measured poses along the line of sight, its optimum, or why it is none."""
    robust, known = options.loss == "huber", options.known_noise()
    if known.pose_translation is not None or options.scale == "free":  # a camera alone sees no pattern in its place
        return setup, result, ""
    for _ in range(SIGHT_ROUNDS):
        problem = with_noise_along_sight(setup.problem, result.optimum.values, robust)
        if problem is setup.problem:
            return setup, result, ""
        setup = replace(setup, problem=problem)
        result = optimise(problem, result.optimum.values, known, robust)
    return setup, result, why_not_reached(setup, result)


def _notes_on_start(setup: Setup, start: LinearStart) -> list[str]:
    """Return what is not used, and what was taken from the guess, in words."""
    guessed = [f"no equation gives '{name}' a linear start; it starts from its guess" for name in start.guessed]
    held = [
        f"pattern '{name}' is held where the guess puts it: only poses relative to it can be known"
        for name in setup.gauge_patterns
    ]
    return [*setup.ignored, *guessed, *held]
