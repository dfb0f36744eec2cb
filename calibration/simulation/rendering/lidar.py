"""Scans of a simulated LiDAR: rays against the pattern, the ground and the boxes around."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.simulation.board import Board
from calibration.simulation.scene import Scene
from calibration.simulation.sensors import SimulatedLidar, SimulatedLidar2d


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution; every array is (rings, azimuths), of a 2D LiDAR (1, rays)."""

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
    lidar: SimulatedLidar | SimulatedLidar2d,
    T_world_lidar: Array,
    scene: Scene,
    boards: Sequence[Board],
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
