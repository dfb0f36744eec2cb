"""Initial values by a dataset's own transforms, with the noise of the matrix, and the cost of given transforms.

The noise is as in ATOM: every additional transform and then every sensor's transform (in the dataset's order; not the
anchored sensor's, not the patterns') is displaced by a translation of fixed length, in a direction
drawn uniformly from the cube and normalised, and rotated by plus or minus a fixed angle about each of
its three fixed Euler axes. Additional transforms that are free per collection get a draw
of their own in each.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.base import solvable
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.least_squares.minimisation import HUBER_THRESHOLD, Termination, minimise, settle
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.ambiguous_views import unflipped
from calibration.engine.estimation.start.build import Setup, build, build_with, usable_labels
from calibration.engine.estimation.start.linear_start import (
    LinearStart,
    linear_start,
    pattern_poses,
    place_gauge_patterns,
)
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import transform, translation


def guess_of_dataset(setup: Setup) -> Values:
    """Return the transforms of the first collection, and the nominal parameters of joints and intrinsics.

    Patterns have no pose yet, unless they are fixed.
    """
    dataset, joints = setup.dataset, {joint.edge: joint.values for joint in setup.dataset.joints.values()}
    values: list[Array] = []
    for block in setup.problem.blocks:
        pattern = dataset.patterns.get(block.name)
        if block.intrinsics:
            values.append(block.intrinsics.camera.intrinsics)
        elif pattern and (not block.held or pattern.name in setup.gauge_patterns):
            shape = (setup.problem.collections, 4, 4) if block.per_collection else (4, 4)
            values.append(np.broadcast_to(np.eye(4), shape).copy())
        elif block.edge in joints:
            values.append(joints[block.edge])
        elif block.edge:
            T = dataset.transforms[block.edge] if block.per_collection else dataset.transform(*block.edge)[0]
            values.append(T @ translation(pattern.centre) if pattern else T)
    return place_gauge_patterns(setup, tuple(values))


def problem_and_start(dataset: Dataset, options: Options) -> tuple[Setup, LinearStart]:
    """Build the problem of a dataset, and its linear start; what the labels leave open of that is the dataset's.

    Raises:
        UndeterminedError: as `build` and `linear_start`.
        InputError: likewise.
    """
    setup = build_with(dataset, options)
    return setup, linear_start(setup, guess_of_dataset(setup))


def guess_with_patterns(setup: Setup) -> Values:
    """Return the dataset's guess, with the patterns, as in ATOM, where the cameras see them from there.

    Raises:
        InputError: no camera sees a fixed pattern.
    """
    return pattern_poses(setup, guess_of_dataset(setup))


@dataclass(frozen=True)
class StartingNoise:
    """Noise of an initial guess."""

    translation: float = 0.0
    """Length of the displacement of each transform, m."""
    rotation: float = 0.0
    """Magnitude of the error of each of its Euler angles, rad."""
    seed: int = 1

    @property
    def is_zero(self) -> bool:
        """Whether it changes nothing, whatever the seed."""
        return self.translation == self.rotation == 0.0


def perturb(setup: Setup, values: Values, noise: StartingNoise) -> Values:
    """Add noise to the transforms to calibrate; the same random numbers for every magnitude of the noise.

    Fixed transforms keep the pose of the robot's description: those fixed by the user, and the sensor that is fixed
    as the origin of a free gauge, as if it were anchored.
    """
    out = list(values)
    for edge, T in _noisy_transforms(setup.dataset, noise).items():
        block = setup.block(edge)
        if not setup.problem.blocks[block].held:
            out[block] = T
    return tuple(out)


def with_starting_noise(dataset: Dataset, noise: StartingNoise) -> Dataset:
    """Return the dataset with the initial guess of `calibrate` as its transforms, for other software.

    Raises:
        InputError: the labels cannot be used.
    """
    usable, _ = usable_labels(dataset)
    noisy = _noisy_transforms(usable, noise)
    kept = set(usable.keys)
    used = [i for i, key in enumerate(dataset.keys) if key in kept]
    for edge in dataset.moving_transforms & noisy.keys():
        everywhere = dataset.transforms[edge].copy()
        everywhere[used] = noisy[edge]
        noisy[edge] = everywhere
    return dataset.with_transforms(noisy)


def _noisy_transforms(dataset: Dataset, noise: StartingNoise) -> dict[Edge, Array]:
    """Return ``T_parent_child`` with noise for every edge that gets some: (4, 4), or (N, 4, 4) if it moves."""
    if noise.is_zero:
        return {}
    rng = np.random.default_rng(noise.seed)
    noisy = {}
    for edge in _noisy_edges(dataset):
        T = dataset.transform(*edge)
        moving = edge in dataset.moving_transforms
        noisy[edge] = (
            np.stack([_with_noise_added(each, noise, rng) for each in T])
            if moving
            else _with_noise_added(T[0], noise, rng)
        )
    return noisy


def _noisy_edges(dataset: Dataset) -> list[Edge]:
    anchored = dataset.sensors[dataset.anchored].edge if dataset.anchored else None
    edges = [*dataset.additional_transforms, *(sensor.edge for sensor in dataset.sensors.values())]
    return [edge for edge in dict.fromkeys(edges) if edge != anchored]


def _with_noise_added(T: Array, noise: StartingNoise, rng: "np.random.Generator") -> Array:
    direction = rng.uniform(-1.0, 1.0, 3)
    signs = rng.choice([-1.0, 1.0], 3)
    t = T[:3, 3] + noise.translation * direction / np.linalg.norm(direction)
    return transform(rotations.from_rpy(rotations.to_rpy(T[:3, :3]) + noise.rotation * signs), t)


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
