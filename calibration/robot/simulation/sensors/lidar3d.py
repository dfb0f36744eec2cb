"""Simulated 3D LiDARs: clouds of points, ring by ring, and their points on patterns."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.errors import InputError
from calibration.base.records import Constraint, Converted, Misfit, between, excludes, field, needs, one_of, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import LIDAR3D, Modality, NoiseKind
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.pointcloud import encode_pcd, read_points
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.points import label_points
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.description import degrees, rising
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.drawing import NO_DATA_COLOUR, PICTURE_HEIGHT_PX, blank, draw_points
from calibration.robot.simulation.sensors.lidar import COORDINATE_DECIMALS, RaySensor
from calibration.robot.simulation.sensors.sensor import LEAST_SHARE, MAX_VIEW_ANGLE, Data, Found, Views

MAX_RINGS = 1000
MAX_RAYS = 4_000_000
"""Limit of the rays of one scan: beyond it memory runs out."""
LEAST_RINGS = 4
"""Minimum of rings that cross the pattern."""


_RISING_ELEVATIONS = Constraint(
    lambda angles: 1 <= len(angles) <= MAX_RINGS and all(abs(angle) <= 90 for angle in angles),
    f"1 to {MAX_RINGS} angles from -90 to 90",
    {"length": (1, MAX_RINGS)},
    whole=True,
)


@record(
    case="snake",
    nulls=True,
    rules=(
        excludes("elevations_deg", "rings"),
        excludes("elevations_deg", "vertical_deg"),
        one_of("elevations_deg", "rings", why="found neither elevations_deg nor rings, expected one of them"),
        needs("rings", "vertical_deg"),
        needs("vertical_deg", "rings"),
    ),
)
class Rings:
    """Rings of a LiDAR: their number and the lowest and highest, or each of them."""

    rings: Annotated[int, between(1, MAX_RINGS)] | None = field("Number of rings, evenly apart.", default=None)
    vertical_deg: Annotated[tuple[float, float], rising(-90, 90)] | None = field(
        "Elevations of the lowest and the highest ring, deg.", default=None
    )
    elevations_deg: Annotated[tuple[float, ...], _RISING_ELEVATIONS] | None = field(
        "Elevation of each ring, in place of rings and vertical_deg, deg.", default=None
    )

    @property
    def elevations(self) -> tuple[float, ...]:
        """Elevation of each ring, rad above the x-y plane."""
        low, high = self.vertical_deg or (0.0, 0.0)
        evenly = map(float, np.linspace(low, high, self.rings or 0))
        return tuple(map(math.radians, self.elevations_deg or evenly))


@record(case="snake", nulls=True)
class SimulatedLidar(RaySensor):
    """LiDAR that rotates about the z axis of its frame; x is azimuth 0."""

    modality: ClassVar[Modality] = LIDAR3D
    label_name: ClassVar[str] = "points"
    file_ending: ClassVar[str] = "pcd"
    scenario_group: ClassVar[str] = "lidars"

    elevations: Annotated[tuple[float, ...], Converted(Rings, lambda rings, _: rings.elevations)] = field(flat=True)
    """Elevation of each ring, rad above the x-y plane."""
    azimuths: Annotated[int, between(8, 100_000)] = field(
        "Number of rays of a ring in one revolution; the first points backwards, along -x."
    )
    reach: Annotated[tuple[float, float], rising(0)] = field(
        "Least and largest range; other surfaces give no return, m.", default=(0.9, 130.0), key="range_m"
    )
    noise: Annotated[float, between(0, 10)] = field("Standard deviation of a range, m.", default=0.008, key="noise_m")
    resolution: Annotated[float, between(0, 10)] = field(
        "Ranges are multiples of it; 0 for none, m.", default=0.001, key="resolution_m"
    )
    margin: Annotated[float, degrees(0, 360)] = field(
        "Returns are stored up to this azimuth beyond the pattern, deg.",
        default=math.radians(5),
        implied=5,
        key="margin_deg",
    )

    def __post_init__(self) -> None:
        """Check the number of rays."""
        if len(self.elevations) * self.azimuths > MAX_RAYS:
            found = f"found {len(self.elevations)} rings of {self.azimuths}"
            raise Misfit(f"{found}, expected {MAX_RAYS} rays at most", "azimuths")

    @property
    def step(self) -> float:
        """Azimuth between two rays of a ring, rad."""
        return 2 * math.pi / self.azimuths

    def directions(self) -> Array:
        """Unit vectors (rings, azimuths, 3) in the sensor's frame."""
        return _ray_directions(self.elevations, self.azimuths)

    def directions_towards(self, pattern: Pattern, T_sensor_pattern: Array) -> Array:
        """Return the rays (rings, A, 3) with an azimuth of the pattern."""
        corners = apply(T_sensor_pattern, np.column_stack([pattern.outline, np.zeros(4)]))
        middle, beside = _azimuths_of(corners)
        first, last = (middle + np.array([beside.min(), beside.max()]) + np.pi) / self.step
        return _unit_vectors(self.elevations, self.step * np.arange(np.ceil(first), np.floor(last) + 1) - np.pi)

    def _ray_azimuths(self) -> Array:
        return _even_azimuths(self.azimuths)

    def render(
        self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator
    ) -> Array:
        """Measure the points (N, 3) on a board and within a margin, in the sensor's frame, m, ring by ring."""
        sector = np.zeros(self.azimuths, bool)
        for board in boards:
            sector |= self._board_sector(board, T_world_sensor)
        scan = self.scan(T_world_sensor, scene, boards, random, sector)
        stored = scan.returns
        rays = self.directions()[:, sector][stored]
        points: Array = np.round(scan.ranges[stored, None] * rays, COORDINATE_DECIMALS) + 0.0
        return points

    def _board_sector(self, board: Board, T_world_sensor: Array) -> BoolArray:
        """Return a mask (A,) of the azimuths of the board and of the margin beside it."""
        middle, beside = _azimuths_of(apply(inverse(T_world_sensor), board.corners()))
        inside: BoolArray = (
            np.abs(_normalise_angle(self._ray_azimuths() - middle)) <= np.abs(beside).max() + self.margin
        )
        return inside

    def message(self, data: Data) -> dict[str, Any]:
        """Return the fields of a PointCloud2."""
        points = len(data)
        return {
            "fields": [{"name": axis, "offset": 4 * i, "datatype": 7, "count": 1} for i, axis in enumerate("xyz")],
            "height": 1,
            "is_bigendian": False,
            "is_dense": True,
            "point_step": 12,
            "row_step": 12 * points,
            "width": points,
        }

    def encode(self, data: Data) -> bytes:
        """Encode as binary PCD."""
        return encode_pcd(data)

    def points(self, data: Data) -> Array:
        """Return the cloud."""
        return np.asarray(data, float)

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Find the points on the pattern."""
        return label_points(data, pattern.pattern(), T_sensor_pattern)

    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses at which enough rings cross the pattern, by its corners; from either side."""
        T_lidar_pattern, board = views.T_sensor_pattern, views.pattern
        corners = apply(T_lidar_pattern, board.corners)
        border = np.linalg.norm(apply(T_lidar_pattern, np.column_stack([board.outline, np.zeros(4)])), axis=-1)
        elevation = np.arcsin(corners[..., 2] / np.linalg.norm(corners, axis=-1))
        rings = np.array(self.elevations)
        between = (rings > elevation.min(-1, keepdims=True)) & (rings < elevation.max(-1, keepdims=True))
        sight = corners.mean(-2) / np.linalg.norm(corners.mean(-2), axis=-1, keepdims=True)
        crossed: BoolArray = (
            (between.sum(-1) >= LEAST_RINGS)
            & (border.min(-1) > self.least_range)
            & (border.max(-1) < self.most_range)
            & (np.abs((T_lidar_pattern[:, :3, 2] * sight).sum(-1)) > np.cos(MAX_VIEW_ANGLE))
            & (views.hidden(board.corners).mean(-1) < 1 - LEAST_SHARE)
        )
        return crossed

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the noise of ranges and of the border, equal at any distance."""
        del distance
        return {"range": self.range_noise, "border": self.border_noise}

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the cloud as seen from the sensor: azimuth to the left, elevation up."""
        del patterns
        picture = blank(2 * PICTURE_HEIGHT_PX, NO_DATA_COLOUR)
        try:
            points = read_points(files / message["data_file"])
        except InputError:
            return picture
        if len(points):
            x, y, z = np.array(points, float).T
            ahead_x, ahead_y = x.mean(), y.mean()
            azimuth = _fast_angle(y * ahead_x - x * ahead_y, x * ahead_x + y * ahead_y)
            elevation = _fast_angle(z, np.sqrt(x * x + y * y))
            place = np.column_stack(
                [_spread_over(-azimuth, 2 * PICTURE_HEIGHT_PX), _spread_over(-elevation, PICTURE_HEIGHT_PX)]
            )
            draw_points(picture, place, range(len(points)), labels)
        return picture


def _even_azimuths(azimuths: int) -> Array:
    """Azimuths (azimuths,) of the rays of a ring, rad."""
    return np.asarray(-np.pi + 2 * math.pi / azimuths * np.arange(azimuths), float)


@lru_cache(maxsize=2)
def _ray_directions(elevations: tuple[float, ...], azimuths: int) -> Array:
    """Unit vectors (rings, azimuths, 3) of a revolution."""
    found = _unit_vectors(elevations, _even_azimuths(azimuths))
    found.flags.writeable = False
    return found


def _unit_vectors(elevations: tuple[float, ...], azimuth: Array) -> Array:
    """Unit vectors (rings, A, 3) of elevations and azimuths (A,)."""
    elevation = np.array(elevations)[:, None]
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], -1)


def _azimuths_of(points: Array) -> tuple[float, Array]:
    """Return the azimuth of the centre of points (N, 3), and theirs (N,) relative to it, -pi to pi."""
    middle = np.arctan2(*points.mean(axis=0)[[1, 0]])
    return middle, _normalise_angle(np.arctan2(points[:, 1], points[:, 0]) - middle)


def _normalise_angle(angle: Array) -> Array:
    """Normalise angles to -pi to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _fast_angle(y: Array, x: Array) -> Array:
    """Angle of (x, y), rad, with an error up to 0.004: numpy's arctan2 is rounded differently on other processors."""
    shorter, longer = np.minimum(np.abs(x), np.abs(y)), np.maximum(np.abs(x), np.abs(y))
    ratio = shorter / np.maximum(longer, 1e-300)
    angle = ratio * (np.pi / 4 + 0.273 * (1 - ratio))
    angle = np.where(np.abs(y) > np.abs(x), np.pi / 2 - angle, angle)
    turned: Array = np.copysign(np.where(x < 0, np.pi - angle, angle), y)
    return turned


def _spread_over(values: Array, length: int) -> Array:
    """Map values to a length, with a margin at its ends."""
    low, high = values.min(), values.max()
    share = (values - low) / max(high - low, 1e-9)
    place: Array = (0.05 + 0.9 * share) * (length - 1)
    return place
