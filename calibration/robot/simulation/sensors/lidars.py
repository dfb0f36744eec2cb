"""Simulated 3D and 2D LiDARs: rays cast to the patterns, the ground and the boxes, and those on patterns."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.base.records import Constraint, Converted, Misfit, between, excludes, field, needs, one_of, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import LIDAR2D, LIDAR3D, Modality, NoiseKind
from calibration.engine.dataset.model import PointLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.sensor_data import encode_pcd, read_points
from calibration.engine.geometry.transforms import apply, inverse
from calibration.engine.statistics import median
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.points import label_points
from calibration.robot.labelling.scan_line import label_scan_line, scan_line_ends
from calibration.robot.simulation.scene import Board, Scene, degrees, listed, rising
from calibration.robot.simulation.sensors.sensor import (
    LEAST_SHARE,
    MAX_VIEW_ANGLE,
    NO_DATA_COLOUR,
    PICTURE_HEIGHT_PX,
    Data,
    Found,
    RangeSensor,
    Views,
    blank,
    draw_points,
    meets,
    range_noise,
)

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
    def step(self) -> float:
        """Angle between two rays, rad."""
        return (self.angles[1] - self.angles[0]) / (self.rays - 1)

    def directions(self) -> Array:
        """Unit vectors (1, rays, 3) in the sensor's frame, a single ring."""
        angle = self.angles[0] + self.step * np.arange(self.rays)
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
            "angle_min": round(self.angles[0], _ANGLE_DECIMALS),
            "angle_max": round(self.angles[1], _ANGLE_DECIMALS),
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
        return np.asarray(np.where(data > 0, data, np.nan)[:, None] * self.directions()[0])

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Find the rays on the pattern."""
        return label_scan_line(self.points(data), pattern.pattern(), T_sensor_pattern)

    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses with a scan line of sufficient length on the pattern."""
        board = views.pattern
        ends = scan_line_ends(board, views.T_sensor_pattern)
        with np.errstate(invalid="ignore"):
            length, distance = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), np.linalg.norm(ends, axis=-1)
            after_first = np.mod(np.arctan2(ends[..., 1], ends[..., 0]) - self.angles[0], 2 * np.pi)
            within = (after_first > self.step) & (after_first < self.angles[1] - self.angles[0] - self.step)
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
        return {"lidar2d_range": self.range_noise, "lidar2d_border": self.border_noise}

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the scan from above, the sensor at the bottom, x up; up to twice the pattern's distance."""
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
        return np.round(scan.ranges[stored, None] * rays, COORDINATE_DECIMALS) + 0.0

    def _board_sector(self, board: Board, T_world_sensor: Array) -> BoolArray:
        """Return a mask (A,) of the azimuths of the board and of the margin beside it."""
        middle, beside = _azimuths_of(apply(inverse(T_world_sensor), board.corners()))
        away = np.abs(_normalise_angle(_even_azimuths(self.azimuths) - middle))
        return np.asarray(away <= np.abs(beside).max() + self.margin)

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
        return np.asarray(
            (between.sum(-1) >= LEAST_RINGS)
            & (border.min(-1) > self.least_range)
            & (border.max(-1) < self.most_range)
            & (np.abs((T_lidar_pattern[:, :3, 2] * sight).sum(-1)) > np.cos(MAX_VIEW_ANGLE))
            & (views.hidden(board.corners).mean(-1) < 1 - LEAST_SHARE)
        )

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the noise of ranges and of the border, equal at any distance."""
        return {"range": self.range_noise, "border": self.border_noise}

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the cloud as seen from the sensor: azimuth to the left, elevation up."""
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
    return np.copysign(np.where(x < 0, np.pi - angle, angle), y)


def _spread_over(values: Array, length: int) -> Array:
    """Map values to a length, with a margin at its ends."""
    low, high = values.min(), values.max()
    share = (values - low) / max(high - low, 1e-9)
    return np.asarray((0.05 + 0.9 * share) * (length - 1))
