"""Simulated 2D LiDARs: scans of one plane, and their rays on patterns."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.records import Converted, between, field, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import LIDAR2D, Modality, NoiseKind
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.residuals.median import median
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.scan_line import label_scan_line, scan_line_ends
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.description import listed, rising
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.drawing import NO_DATA_COLOUR, PICTURE_HEIGHT_PX, blank, draw_points
from calibration.robot.simulation.sensors.lidar import COORDINATE_DECIMALS, RaySensor
from calibration.robot.simulation.sensors.sensor import LEAST_SHARE, MAX_VIEW_ANGLE, Data, Found, Views

LEAST_SCAN_LINE = 0.5
"""Minimum length of a scan line on a pattern, in the pattern's smaller side: a shorter one has little information."""
_ANGLE_DECIMALS = 12


_ANGLE_RANGE = listed(
    2,
    "two rising numbers from -360 to 360, at most 360 apart and not the same",
    lambda ends: -360 <= ends[0] < ends[1] <= min(360, ends[0] + 360),
)


@record(case="snake", nulls=True)
class SimulatedLidar2d(RaySensor):
    """LiDAR whose rays are in the plane z = 0 of its frame; x is angle 0, y a quarter of a revolution."""

    modality: ClassVar[Modality] = LIDAR2D
    label_name: ClassVar[str] = "rays"

    rays: Annotated[int, between(8, 100_000)] = field("Number of rays.")
    angles: Annotated[
        tuple[float, float],
        Converted(Annotated[tuple[float, float], _ANGLE_RANGE], lambda ends, _: tuple(map(math.radians, ends))),
    ] = field("Angles of the first and the last ray, deg.", implied=[-135, 135], key="angle_deg")
    reach: Annotated[tuple[float, float], rising(0)] = field(
        "Least and largest range; other surfaces give no return, m.", default=(0.1, 30.0), key="range_m"
    )
    noise: Annotated[float, between(0, 10)] = field("Standard deviation of a range, m.", default=0.01, key="noise_m")
    resolution: Annotated[float, between(0, 10)] = field(
        "Ranges are multiples of it; 0 for none, m.", default=0.001, key="resolution_m"
    )

    @property
    def angle_min(self) -> float:
        """Angle of the first ray, rad."""
        return self.angles[0]

    @property
    def angle_max(self) -> float:
        """Angle of the last ray, rad."""
        return self.angles[1]

    @property
    def step(self) -> float:
        """Angle between two rays, rad."""
        return (self.angle_max - self.angle_min) / (self.rays - 1)

    def directions(self) -> Array:
        """Unit vectors (1, rays, 3) in the sensor's frame, a single ring."""
        angle = self.angle_min + self.step * np.arange(self.rays)
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(self.rays)], -1)[None]

    def render(
        self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator
    ) -> Array:
        """Measure the ranges (rays,), m; 0 without a return, or if noise puts it out of range: JSON has no NaN."""
        ranges = np.round(self.scan(T_world_sensor, scene, boards, random).ranges[0], COORDINATE_DECIMALS)
        with np.errstate(invalid="ignore"):
            returned = (ranges >= self.least_range) & (ranges <= self.most_range)
        return np.where(returned, ranges, 0.0)

    def message(self, data: Data) -> dict[str, Any]:
        """Return the complete LaserScan, except for its header."""
        return {
            "angle_min": round(self.angle_min, _ANGLE_DECIMALS),
            "angle_max": round(self.angle_max, _ANGLE_DECIMALS),
            "angle_increment": round(self.step, _ANGLE_DECIMALS),
            "time_increment": 0.0,
            "scan_time": 0.0,
            "range_min": self.least_range,
            "range_max": self.most_range,
            "ranges": data.tolist(),
            "intensities": [],
        }

    def points(self, data: Data) -> Array:
        """Return the points (rays, 3); NaN without a return."""
        points: Array = np.where(data > 0, data, np.nan)[:, None] * self.directions()[0]
        return points

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Find the rays on the pattern."""
        return label_scan_line(self.points(data), pattern.pattern(), T_sensor_pattern)

    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses with a scan line of sufficient length on the pattern."""
        board = views.pattern
        ends = scan_line_ends(board, views.T_sensor_pattern)
        with np.errstate(invalid="ignore"):
            length, distance = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), np.linalg.norm(ends, axis=-1)
            after_first = np.mod(np.arctan2(ends[..., 1], ends[..., 0]) - self.angle_min, 2 * np.pi)
            within = (after_first > self.step) & (after_first < self.angle_max - self.angle_min - self.step)
            nearest = np.abs(ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]) / length  # of the line
            middle = np.linalg.norm(ends.mean(1), axis=-1)
            cut: BoolArray = (
                (length > LEAST_SCAN_LINE * np.ptp(board.outline, axis=0).min())
                & (nearest > self.least_range)
                & (distance.max(-1) < self.most_range)
                & within.all(-1)
                & (nearest > np.cos(MAX_VIEW_ANGLE) * middle)
                & (views.hidden(board.corners).mean(-1) < 1 - LEAST_SHARE)
            )
        return cut

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the noise of ranges and of the ends of a scan line, equal at any distance."""
        del distance
        return {"lidar2d_range": self.range_noise, "lidar2d_border": self.border_noise}

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the scan from above, the sensor at the bottom, x up; up to twice the pattern's distance."""
        del patterns, files
        picture = blank(2 * PICTURE_HEIGHT_PX, NO_DATA_COLOUR)
        ranges = message.get("ranges")
        if ranges is None:  # from applications in containers, whose scans are not drawn
            return picture
        points = self.points(np.array(ranges))[:, :2]
        labelled = [index for label in labels for index in label["idxs"]]
        shown = labelled or np.flatnonzero(np.isfinite(points[:, 0])).tolist()
        if shown:
            reach = 2 * median(np.linalg.norm(points[shown], axis=-1))
            place = np.array([PICTURE_HEIGHT_PX, PICTURE_HEIGHT_PX - 1]) - PICTURE_HEIGHT_PX / reach * points[:, ::-1]
            inside = np.flatnonzero(((place >= 0) & (place < [2 * PICTURE_HEIGHT_PX, PICTURE_HEIGHT_PX])).all(-1))
            draw_points(picture, place, inside.tolist(), labels)
        return picture
