"""Noisy initial guesses of the matrix, as in ATOM.

Every additional transform and then every sensor's transform (in the dataset's order; not the
anchored sensor's, not the patterns') is displaced by a translation of fixed length, in a direction
drawn uniformly from the cube and normalised, and rotated by plus or minus a fixed angle about each of
its three fixed Euler axes. Additional transforms that are free per collection get a draw
of their own in each.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.usable_labels import usable_labels
from calibration.engine.estimation.start.build import Setup
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import transform


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
