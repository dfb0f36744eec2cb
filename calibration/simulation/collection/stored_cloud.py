"""The part of a scan that a dataset keeps: the returns around the patterns, ring by ring."""

from collections.abc import Sequence

import numpy as np

from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.board import Board
from calibration.simulation.rendering.lidar import Scan
from calibration.simulation.sensors import SimulatedLidar

_DECIMALS = 6
"""A micrometre: the last bits of a machine's arithmetic do not show."""


def stored_cloud(lidar: SimulatedLidar, scan: Scan, boards: Sequence[Board], T_world_lidar: Array) -> Array:
    """The points (N, 3) of the returns up to the LiDAR's margin beside a board, in the sensor's frame, m."""
    stored = scan.returns & np.any([_sector(lidar, board, T_world_lidar) for board in boards], axis=0)
    points: Array = np.round(scan.ranges[stored, None] * lidar.directions()[stored], _DECIMALS) + 0.0
    return points


def _sector(lidar: SimulatedLidar, board: Board, T_world_lidar: Array) -> BoolArray:
    """Which columns (A,) of azimuth see the board or what is up to the margin beside it."""
    corners = apply(inverse(T_world_lidar), board.corners())
    middle = np.arctan2(*corners.mean(axis=0)[[1, 0]])
    reach = np.abs(_turn(np.arctan2(corners[:, 1], corners[:, 0]) - middle)).max() + lidar.margin
    azimuth = -np.pi + lidar.step * np.arange(lidar.azimuths)
    inside: BoolArray = np.abs(_turn(azimuth - middle)) <= reach
    return inside


def _turn(angle: Array) -> Array:
    """Angles between -pi and pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
