"""A rig of cameras and moving boards as plain arrays: what every solver is given."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.scenes import CAMERA, rig
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Collection, CornerLabels
from calibration.engine.estimation.least_squares.minimisation import WeightedOptimum, optimise
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.geometry.transforms import inverse, translation


@dataclass(frozen=True, eq=False)
class RigArrays:
    """C cameras, N boards of K corners, all seen; and where to start."""

    pixels: Array
    """(C N, 2, K): the labels, camera by camera."""
    corners: Array
    """(K, 3): m; the first is the origin of the board."""
    intrinsics: Array
    """(9,): fx, fy, cx, cy, k1, k2, p1, p2, k3 of all cameras."""
    T_camera_world: Array
    """(C, 4, 4): the start; the first camera is the world and stays."""
    T_world_board: Array
    """(N, 4, 4): the start."""
    free_intrinsics: bool = False
    """Whether the intrinsics of every camera are to be found too; those given are the start."""

    def views(self, T_camera_world: Array, T_world_board: Array) -> Array:
        """``T_camera_board`` (C N, 4, 4) in the order of the pixels."""
        T: Array = (T_camera_world[:, None] @ T_world_board).reshape(-1, 4, 4)
        return T

    def save(self, path: Path) -> None:
        """Write an .npz file for a solver in another process."""
        np.savez(path, **vars(self))


@dataclass(frozen=True, eq=False)
class RigProblem:
    """The same rig as the engine has it."""

    setup: Setup
    guess: Values
    """What the linear start is given; it only serves what no equation gives, which is nothing here."""
    start: Values
    """From the linear start."""
    arrays: RigArrays
    centre: Array
    """(3,): of the board; the engine's boards stand at their centres."""

    def poses(self, values: Values) -> tuple[Array, Array]:
        """``T_camera_world`` (C, 4, 4) and ``T_world_board`` (N, 4, 4)."""
        boards = values[-1] @ inverse(translation(self.centre))
        return inverse(np.stack(values[:-1])), boards


def corner_pixels(collection: Collection) -> list[Array]:
    """The labels (K, 2) of each camera in one collection."""
    return [label.pixels for label in collection.labels.values() if isinstance(label, CornerLabels)]


def rig_problem(collections: int, cameras: int = 2, seed: int = 0) -> RigProblem:
    """A rig with its linear start."""
    dataset, T_world_camera = rig(collections, cameras, seed)
    setup = build(dataset)
    (pattern,) = dataset.patterns.values()
    guess = (*T_world_camera, np.broadcast_to(np.eye(4), (collections, 4, 4)).copy())
    start = linear_start(setup, guess).values
    pixels = np.stack([[labels.T for labels in corner_pixels(collection)] for collection in dataset.collections], 1)
    d = CAMERA.distortion
    intrinsics = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, d.k1, d.k2, d.p1, d.p2, d.k3])
    problem = RigProblem(
        setup,
        guess,
        start,
        RigArrays(
            np.ascontiguousarray(pixels.reshape(-1, *pixels.shape[2:])),
            pattern.corners,
            intrinsics,
            inverse(np.stack(start[:-1])),
            start[-1] @ inverse(translation(pattern.centre)),
        ),
        pattern.centre,
    )
    assert [problem.setup.block(sensor.edge) for sensor in dataset.sensors.values()] == list(range(cameras))
    return problem


def solve(setup: Setup, guess: Values, robust: bool) -> WeightedOptimum:
    """The whole solve from arrays of pixels: linear start, least squares, noise level."""
    return optimise(setup.problem, linear_start(setup, guess).values, NoiseLevels(), robust)
