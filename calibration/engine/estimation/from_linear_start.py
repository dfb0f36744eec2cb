"""Calibration from a linear initial guess."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.at_optimum import OpenCoefficientsError, calibration_at, why_invalid, why_not_reached
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.noise_levels import with_noise_along_sight
from calibration.engine.estimation.least_squares.optimisation import WeightedOptimum, optimise
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.fixing import held_blocks
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.flipped_patterns import unflipped
from calibration.engine.estimation.start.linear_start import LinearStart

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
