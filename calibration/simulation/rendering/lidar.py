"""Scans of a simulated LiDAR: rays against the pattern, the ground and the boxes around."""

from dataclasses import dataclass

import numpy as np

from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.simulation.scene import Scene
from calibration.simulation.sensors import SimulatedLidar


@dataclass(frozen=True, eq=False)
class Board:
    """A pattern as an obstacle: its rectangular border in its plane z = 0, without thickness."""

    T_world_pattern: Array
    """(4, 4)."""
    outline: Array
    """(4, 2): `calibration.dataset.pattern.Pattern.outline`."""

    def cast(self, origin: Array, directions: Array) -> Array:
        """The distances (...) along rays from one point (3,); infinite where they miss. See `Scene.cast`."""
        T_pattern_world = inverse(self.T_world_pattern)
        start = apply(T_pattern_world, origin[None])[0]
        x, y, z = T_pattern_world[:3, :3] @ np.moveaxis(directions, -1, 0).reshape(3, -1)
        (left, top), (right, bottom) = self.outline.min(axis=0), self.outline.max(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -start[2] / z
            u, v = start[0] + t * x, start[1] + t * y
            hit = (t > 0) & (u >= left) & (u <= right) & (v >= top) & (v <= bottom)
        return np.where(hit, t, np.inf).reshape(directions.shape[:-1])

    def corners(self) -> Array:
        """(4, 3): the corners of the border in the world frame."""
        return apply(self.T_world_pattern, np.column_stack([self.outline, np.zeros(4)]))


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution; every array is (rings, azimuths)."""

    ranges: Array
    """As measured, m; NaN where nothing comes back."""
    board: IntArray
    """The index of the board that the ray comes back from; -1 for anything else."""
    crossed: IntArray
    """The index of the nearest board on the ray's way, whether or not something hides it; -1 for none."""

    @property
    def returns(self) -> BoolArray:
        """Which rays come back."""
        return ~np.isnan(self.ranges)


def scan(
    lidar: SimulatedLidar,
    T_world_lidar: Array,
    scene: Scene,
    boards: list[Board],
    random: np.random.Generator,
) -> Scan:
    """Cast every ray; the nearest surface comes back, with Gaussian noise along the ray.

    The generator gives one number for every ray, so that what is hit does not change the noise of others.
    """
    rays = lidar.directions()
    noise = lidar.noise * random.standard_normal(rays.shape[:-1])
    directions, origin = rays @ T_world_lidar[:3, :3].T, T_world_lidar[:3, 3]
    nearest_board = np.full(rays.shape[:-1], np.inf)
    crossed = np.full(rays.shape[:-1], -1)
    for i, board in enumerate(boards):
        distance = board.cast(origin, directions)
        nearer = distance < nearest_board
        nearest_board[nearer], crossed[nearer] = distance[nearer], i
    nearest = np.minimum(scene.cast(origin, directions), nearest_board)
    measured = nearest + noise
    if lidar.resolution:
        measured = np.round(measured / lidar.resolution) * lidar.resolution
    in_range = (nearest >= lidar.least_range) & (nearest <= lidar.most_range)
    visible = in_range & (nearest == nearest_board)
    return Scan(np.where(in_range, measured, np.nan), np.where(visible, crossed, -1), crossed)
