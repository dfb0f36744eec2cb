"""Cost of the labels at given transforms, such as those of other software."""

from dataclasses import replace

import numpy as np

from calibration.base.errors import solvable
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.solve.least_squares import Termination, minimise, settle
from calibration.engine.estimation.solve.noise_levels import NoiseLevels
from calibration.engine.estimation.solve.normal_equations import Weighting
from calibration.engine.estimation.solve.optimisation import HUBER_THRESHOLD
from calibration.engine.estimation.solve.options import Options
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.flipped_patterns import unflipped
from calibration.engine.estimation.start.guesses import guess_with_patterns

_TERMINATION_NEARBY = Termination(decrease=1e-3, iterations=30)
"""Enough to compare the patterns' poses with their mirror images."""


def cost_of(dataset: Dataset, options: Options, levels: NoiseLevels) -> float:
    """Return the cost of a dataset's labels at its sensors' poses, minimised over the patterns' poses.

    Sensors, joints, intrinsics and transforms that are the same in all collections are fixed; patterns, and
    transforms per collection are optimised from the poses in the cameras' views.

    Args:
        dataset: labels, transforms and intrinsics.
        options: the loss, and the fixed patterns.
        levels: the standard deviations of all kinds of labels in it.

    Returns:
        The sum of squared residuals in standard deviations, with Huber's loss if it is robust; infinite if a
        pattern is behind its camera.

    Raises:
        UndeterminedError: the data cannot be calibrated.
        InputError: the labels cannot be used.
    """
    with solvable(dataset.path), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        setup = _with_patterns_alone(build(dataset, options.hold))
        problem, everywhere = setup.problem, np.ones(setup.problem.collections, bool)
        weighting = Weighting(levels.given(), HUBER_THRESHOLD if options.loss == "huber" else None)
        start = guess_with_patterns(setup)
        values, cost = settle(problem, start, weighting, everywhere, _TERMINATION_NEARBY)
        if not np.isfinite(cost).all():
            return np.inf
        values, _ = unflipped(problem, values, weighting, cost)
        return minimise(problem, values, weighting).cost


def _with_patterns_alone(setup: Setup) -> Setup:
    """Return the problem with all shared blocks fixed, except for patterns that the user has not fixed."""
    free = set(setup.dataset.patterns) - {b.name for b in setup.problem.blocks if b.held} | set(setup.gauge_patterns)
    blocks = tuple(
        replace(block, held=block.name not in free and (block.held or not block.per_collection))
        for block in setup.problem.blocks
    )
    return replace(setup, problem=replace(setup.problem, blocks=blocks))
