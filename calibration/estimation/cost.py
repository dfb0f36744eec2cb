"""What the labels cost at transforms that something else has found."""

from dataclasses import replace

import numpy as np

from calibration.dataset.model import Dataset
from calibration.errors import solvable
from calibration.estimation.build import Setup, build
from calibration.estimation.calibrate import initial_values
from calibration.estimation.least_squares import Termination, minimise, settle
from calibration.estimation.linear_start import pattern_poses
from calibration.estimation.noise_levels import NoiseLevels
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.optimisation import HUBER, unflipped
from calibration.estimation.options import Options

_NEAR = Termination(decrease=1e-3, iterations=30)
"""Near enough for the patterns' poses to be compared with their mirror images."""


def cost_of(dataset: Dataset, options: Options, levels: NoiseLevels) -> float:
    """The cost of a dataset's labels where its sensors are, each pattern where it fits best.

    Sensors, joints, intrinsics and transforms that are the same in all collections are held; patterns, and what each
    collection has its own of, are optimised from where the cameras see them.

    Args:
        dataset: labels, transforms and intrinsics.
        options: the loss, and the patterns to hold.
        levels: the standard deviations of all kinds of labels in it.

    Returns:
        The sum of squared residuals in standard deviations, with Huber's loss where it is robust; infinite where a
        camera would see the pattern behind itself.

    Raises:
        UndeterminedError: the data cannot be calibrated.
        InputError: the labels cannot be used.
    """
    with solvable(dataset.path), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        setup = _with_patterns_alone(build(dataset, options.hold))
        problem, everywhere = setup.problem, np.ones(setup.problem.collections, bool)
        weighting = Weighting(levels.given(), HUBER if options.loss == "huber" else None)
        start = pattern_poses(setup, initial_values(setup))
        values, cost = settle(problem, start, weighting, everywhere, _NEAR)
        if not np.isfinite(cost).all():
            return np.inf
        values, _ = unflipped(problem, values, weighting, cost)
        return minimise(problem, values, weighting).cost


def _with_patterns_alone(setup: Setup) -> Setup:
    """The problem with all shared blocks held, but patterns that the user does not hold."""
    free = set(setup.dataset.patterns) - {b.name for b in setup.problem.blocks if b.held} | set(setup.gauge_patterns)
    blocks = tuple(
        replace(block, held=block.name not in free and (block.held or not block.per_collection))
        for block in setup.problem.blocks
    )
    return replace(setup, problem=replace(setup.problem, blocks=blocks))
