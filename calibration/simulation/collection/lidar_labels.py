"""What a LiDAR stores and labels: a cloud, its points on the pattern, and those on its border."""

from dataclasses import dataclass

import numpy as np

from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.simulation.rendering.lidar import Board, Scan
from calibration.simulation.sensors import SimulatedLidar

MIN_POINTS = 10
"""A pattern with fewer points is not detected (ATOM's rule)."""
MIN_RINGS = 2
"""The points of one ring lie on a line, through which no plane is determined."""


@dataclass(frozen=True, eq=False)
class PatternPoints:
    """The labels of one pattern, as indices into the stored cloud."""

    on_pattern: IntArray
    on_border: IntArray
    """The points of least and greatest azimuth of each ring on the pattern, in the order of the rings."""


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """A cloud, ring by ring, and what lies on each pattern."""

    points: Array
    """(N, 3), in the sensor's frame, m."""
    patterns: tuple[PatternPoints | None, ...]
    """For each board; None where it is not detected."""


def label_cloud(lidar: SimulatedLidar, scan: Scan, boards: list[Board], T_world_lidar: Array) -> LabelledCloud:
    """The returns around the boards, and the labels on them."""
    order, sectors = zip(*(_sector(lidar, board, T_world_lidar) for board in boards), strict=True)
    stored = scan.returns & np.any(sectors, axis=0)
    index = np.where(stored, np.cumsum(stored).reshape(stored.shape) - 1, -1)
    points = np.round(scan.ranges[stored, None] * lidar.directions()[stored], 6) + 0.0
    return LabelledCloud(points, tuple(_label(scan, i, columns, index) for i, columns in enumerate(order)))


def _sector(lidar: SimulatedLidar, board: Board, T_world_lidar: Array) -> tuple[IntArray, BoolArray]:
    """The azimuth columns (A,) in the order in which the board is swept, and which of them (A,) are stored.

    The order begins behind the board, so that no board lies on the seam.
    """
    T_lidar_world = inverse(T_world_lidar)
    corners = apply(T_lidar_world, board.corners())
    middle = np.arctan2(*corners.mean(axis=0)[[1, 0]])
    first = int(np.floor(middle / lidar.step)) % lidar.azimuths  # column 0 stands at -pi: this one is opposite
    columns = (first + np.arange(lidar.azimuths)) % lidar.azimuths
    beside = np.arctan2(corners[:, 1], corners[:, 0]) - middle
    reach = np.abs((beside + np.pi) % (2 * np.pi) - np.pi).max() + lidar.margin
    azimuth = -np.pi + lidar.step * np.arange(lidar.azimuths) - middle
    return columns, np.abs((azimuth + np.pi) % (2 * np.pi) - np.pi) <= reach


def _label(scan: Scan, board: int, columns: IntArray, index: IntArray) -> PatternPoints | None:
    """The labels of one board.

    The outermost visible points of a ring are on the border unless the next ray outwards crosses
    the board too: then something hides the rest of it.
    """
    visible, crossed = (scan.board == board)[:, columns], (scan.crossed == board)[:, columns]
    rings = np.flatnonzero(visible.any(axis=1))
    if visible.sum() < MIN_POINTS or len(rings) < MIN_RINGS:
        return None
    border = []
    for ring in rings:
        seen, on_way = np.flatnonzero(visible[ring]), np.flatnonzero(crossed[ring])
        ends = {end: None for end, outermost in zip(seen[[0, -1]], on_way[[0, -1]], strict=True) if end == outermost}
        border += [index[ring, columns[end]] for end in ends]
    return PatternPoints(index[scan.board == board], np.array(border, dtype=np.int64))
