"""Common parts of simulated 3D and 2D LiDARs: ray casting to the patterns, the ground and the boxes."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import PointLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.sensor import RangeSensor, Views, meets, range_noise

COORDINATE_DECIMALS = 6
"""Decimals of stored coordinates, m: a micrometre, so that rounding errors of the arithmetic have no effect."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Scan of one revolution or a part of it; every array is (rings, azimuths), for a 2D LiDAR (1, rays)."""

    ranges: Array
    """Measured ranges, m; NaN without a return."""
    board: IntArray
    """Index of the board that the ray hits; -1 for anything else."""
    crossed: IntArray
    """Index of the nearest board on the ray, occluded or not; -1 for none."""

    @property
    def returns(self) -> BoolArray:
        """Mask of the rays with a return."""
        return ~np.isnan(self.ranges)


class RaySensor(RangeSensor):
    """Sensor that casts rays in rings, one after the other."""

    resolution: float
    """Ranges are multiples of it, m; 0 for none."""

    @property
    @abstractmethod
    def step(self) -> float:
        """Angle between two rays of a ring, rad."""

    @abstractmethod
    def directions(self) -> Array:
        """Unit vectors (rings, rays, 3) in the sensor's frame."""

    def directions_towards(self, pattern: Pattern, T_sensor_pattern: Array) -> Array:
        """Return rays (rings, A, 3) that include all that can hit a pattern, the same azimuths for every ring."""
        del pattern, T_sensor_pattern
        return self.directions()

    def scan(
        self,
        T_world_sensor: Array,
        scene: Scene,
        boards: Sequence[Board],
        random: np.random.Generator,
        columns: BoolArray | None = None,
    ) -> Scan:
        """Cast rays to the nearest surface, with Gaussian noise along the ray.

        One random number is drawn for every ray of the sensor, so that hits and omitted rays do not change the
        noise of other rays.

        Args:
            T_world_sensor: (4, 4).
            scene: the surroundings.
            boards: the patterns.
            random: source of the noise.
            columns: (rays,), mask of the cast rays of each ring; the scan has only these. All by default.
        """
        rays = self.directions()
        noise = self.noise * random.standard_normal(rays.shape[:-1])
        directions, origin = rays @ T_world_sensor[:3, :3].T, T_world_sensor[:3, 3]
        if columns is not None:
            noise, directions = noise[:, columns], directions[:, columns]
        nearest_board = np.full(noise.shape, np.inf)
        crossed = np.full(noise.shape, -1)
        for i, board in enumerate(boards):
            distance = board.cast(origin, directions)
            nearer = distance < nearest_board
            nearest_board[nearer], crossed[nearer] = distance[nearer], i
        nearest = np.minimum(scene.cast(origin, directions), nearest_board)
        measured = nearest + noise
        if self.resolution:
            measured = np.round(measured / self.resolution) * self.resolution
        in_range = (nearest >= self.least_range) & (nearest <= self.most_range)
        visible = in_range & (nearest == nearest_board)
        return Scan(np.where(in_range, measured, np.nan), np.where(visible, crossed, -1), crossed)

    def points_on(self, views: Views, number: int) -> PointLabels:
        """Return the points of one scan on the pattern; the outermost of each ring are on the border."""
        rays = self.directions_towards(views.pattern, views.T_sensor_pattern[number])
        distance, hits = meets(views.pattern, views.T_sensor_pattern[number], rays)
        outermost = np.zeros_like(hits)
        ring = np.flatnonzero(hits.any(1))
        outermost[ring, hits[ring].argmax(1)] = True
        outermost[ring, hits.shape[1] - 1 - hits[ring, ::-1].argmax(1)] = True
        points, outermost = distance[hits, None] * rays[hits], outermost[hits]
        visible = self.visible(views, number, points, np.linalg.norm(points, axis=-1))
        return PointLabels(points[visible], np.flatnonzero(outermost[visible]))

    @property
    def range_noise(self) -> float:
        """Standard deviation of a range, its resolution included, m."""
        return range_noise(float(np.hypot(self.noise, self.resolution / np.sqrt(12))))

    @property
    def border_noise(self) -> float:
        """Standard deviation of the direction in which a ring's last ray on a pattern finds its border, rad."""
        return float(self.step / np.sqrt(12))
