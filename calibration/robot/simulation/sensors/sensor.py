"""Base classes of simulated sensors: read their description, measure, label, predict their labels, draw their data.

Pictures are drawn with a resolution of 1/16 px.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import Modality, NoiseKind
from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.scene import Board, Scene

PICTURE_HEIGHT_PX = 160
"""Height of one picture, px."""
NO_DATA_COLOUR = (45, 40, 35)
"""Colour without a measurement."""
ON_PATTERN, ON_BORDER = (90, 200, 90), (60, 120, 255)
"""Colours of labelled points."""
_POINT_COLOUR = (150, 140, 130)
_SHIFT_BITS = 4  # drawing in sixteenths of a pixel
_DOT_RADIUS = 24  # radius of a corner's mark, in sixteenths of a pixel
_COLOUR_MAP = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_JET)[:, 0]


def blank(width: int, colour: tuple[int, int, int] = (128, 128, 128)) -> Image:
    """Return a picture of one colour; grey by default."""
    return np.full((PICTURE_HEIGHT_PX, width, 3), colour, np.uint8)


def draw_points(picture: Image, place: Array, shown: Iterable[int], labels: Sequence[Mapping[str, Any]]) -> None:
    """Draw points of a cloud or scan into a picture.

    Args:
        picture: (H, W, 3).
        place: (N, 2), position of each point in it.
        shown: the indices of the points that are drawn, labelled or not.
        labels: of each pattern, with ``idxs`` and ``idxs_limit_points``.
    """
    groups = [(list(shown), _POINT_COLOUR, 1)]
    for label in labels:
        groups += [(label["idxs"], ON_PATTERN, 1), (label["idxs_limit_points"], ON_BORDER, 2)]
    for indices, colour, radius in groups:
        for at in place[indices]:
            cv2.circle(picture, _as_sixteenths(at), radius << _SHIFT_BITS, colour, -1, cv2.LINE_AA, _SHIFT_BITS)


def draw_corner(picture: Image, at: Array, share: float) -> None:
    """Draw a corner at a position (2,) in a colour between red (share 0) over green to blue (share 1)."""
    blue, green, red = _COLOUR_MAP[round(255 * (1 - share))]
    cv2.circle(
        picture, _as_sixteenths(at), _DOT_RADIUS, (int(blue), int(green), int(red)), -1, cv2.LINE_AA, _SHIFT_BITS
    )


def _as_sixteenths(at: Array) -> tuple[int, int]:
    """Convert a position to sixteenths of a pixel."""
    x, y = np.floor(at * (1 << _SHIFT_BITS) + 0.5 + 1e-6).astype(
        int
    )  # so that ties are rounded equally on all machines
    return int(x), int(y)


MAX_VIEW_ANGLE = math.radians(65)
"""Limit of the angle between the pattern's normal and the line of sight: beyond it detectors miss corners."""


def facing(T_sensor_pattern: Array, centre: Array) -> BoolArray:
    """Return a mask of the poses (..., 4, 4) that show the front of the pattern, within `MAX_VIEW_ANGLE`.

    The pattern's z axis points away from a sensor that sees it; centre (3,) is in the pattern's frame.
    """
    sensor = inverse(T_sensor_pattern)[..., :3, 3] - centre
    return np.asarray(-sensor[..., 2] > math.cos(MAX_VIEW_ANGLE) * np.linalg.norm(sensor, axis=-1))


def corners_in_image(camera: Camera, points: Array) -> tuple[Array, BoolArray]:
    """Project points (..., K, 3) in the camera frame to pixels (..., K, 2); mask (..., K) of those in the image."""
    pixels, visible = camera.project_visible(points)
    return pixels, visible & camera.contains(pixels)


Data = NDArray[Any]
"""Data of a sensor at one pose; each modality has its own shape and unit."""
Found = CornerLabels | PatternPoints | NotDetected
"""Result of a detector for one pattern in a sensor's data."""
LEAST_SHARE = 0.5
"""Minimum share of a pattern's corners: a view of fewer has little information, and a detector may miss it."""
_LEAST_RANGE_NOISE = 1e-4  # m: a sensor without noise would have infinite weight


@dataclass(frozen=True, eq=False)
class Views:
    """Views of a pattern by a sensor at N poses."""

    configuration: PatternConfiguration
    pattern: Pattern
    scene: Scene
    """Scene with possible occluders."""
    T_world_sensor: Array
    """(N, 4, 4)."""
    T_world_pattern: Array
    """(N, 4, 4)."""

    @cached_property
    def T_sensor_pattern(self) -> Array:
        """(N, 4, 4)."""
        return inverse(self.T_world_sensor) @ self.T_world_pattern

    def hidden(self, points: Array) -> BoolArray:
        """Return a mask (N, K) of the points (K, 3) in the pattern's frame that are occluded from the sensor."""
        return self.scene.hides(self.T_world_sensor[:, :3, 3], apply(self.T_world_pattern, points))


class SimulatedSensor(ABC):
    """Sensor of one modality, as in ``simulation.yml``; every subclass is a record."""

    modality: ClassVar[Modality]
    label_name: ClassVar[str]
    """Name of its counted labels: "corners"."""
    file_ending: ClassVar[str | None] = None
    """Ending of the files with its data; None if they are in the dataset's JSON."""
    scenario_group: ClassVar[str | None] = None
    """Key of a scenario set for all sensors of this kind; None if there is none."""

    noise: float
    """Standard deviation of its measurements: grey levels of an image, m of a range."""

    @abstractmethod
    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """Return the sensor with values of a scenario's parameters; ``name`` is for messages.

        Raises:
            InputError: it has no such parameter.
        """

    @property
    def intrinsics(self) -> Camera | None:
        """Intrinsics of a sensor with an image."""
        return None

    @abstractmethod
    def render(self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator) -> Data:
        """Measure the scene.

        Args:
            T_world_sensor: (4, 4), to the frame of its data.
            scene: the surroundings, and the light.
            boards: the patterns.
            random: one number is drawn for each pixel or ray, whatever it sees.
        """

    @abstractmethod
    def message(self, data: Data) -> dict[str, Any]:
        """Return the fields of the ROS message in a dataset, without its header and the name of the data file."""

    def encode(self, data: Data) -> bytes:
        """Encode the data file, if there is one."""
        raise AssertionError(f"the data of {self.modality} sensors are in no file")

    @abstractmethod
    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Detect a pattern at the approximate pose ``T_sensor_pattern`` (4, 4), as a data collector knows it."""

    @abstractmethod
    def label_document(self, found: Found) -> dict[str, Any]:
        """Return the labels of one pattern in a dataset."""

    def points(self, data: Data) -> Array | None:
        """Return the points (N, 3) in the sensor's frame, m, NaN without a return; None if the data are an image."""
        return None

    @abstractmethod
    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses at which a detector reliably finds the pattern."""

    @abstractmethod
    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """Return the exact labels, by the index of the poses at which the pattern is detected."""

    @abstractmethod
    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the expected standard deviations (px, m, rad) of its labels of a pattern at a distance (m)."""

    @abstractmethod
    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw a small picture of its data at a pose, with the labels; grey if its data cannot be read.

        Args:
            message: the sensor's, in the dataset.
            labels: of each pattern, as from `label_document`.
            patterns: the labelled patterns.
            files: the folder with the files that the message names.
        """


class RangeSensor(SimulatedSensor):
    """Sensor that measures ranges."""

    reach: tuple[float, float]
    """Minimum and maximum range, m; surfaces outside give no return."""

    @property
    def least_range(self) -> float:
        """Minimum range, m."""
        return self.reach[0]

    @property
    def most_range(self) -> float:
        """Maximum range, m."""
        return self.reach[1]

    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """Return the sensor with another noise."""
        return replace(self, noise=values["noise_m"]) if "noise_m" in values else self  # type: ignore[type-var]

    def label_document(self, found: Found) -> dict[str, Any]:
        """Return the indices of the points on the pattern, and of those on its border."""
        return range_label_document(found)

    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """Return the exact points on the pattern, and on its border."""
        return {number: self.points_on(views, number) for number in np.flatnonzero(self.detects(views)).tolist()}

    @abstractmethod
    def points_on(self, views: Views, number: int) -> PointLabels:
        """Return the intersections of the sensor's rays with the pattern in one of the views, by its index."""

    def visible(self, views: Views, number: int, points: Array, ranges: Array) -> BoolArray:
        """Return a mask (K,) of points (K, 3) in the sensor's frame in range (by ranges (K,)) and not occluded."""
        T_world_sensor = views.T_world_sensor[number]
        visible: BoolArray = (ranges >= self.least_range) & (ranges <= self.most_range)
        return visible & ~views.scene.hides(T_world_sensor[:3, 3], apply(T_world_sensor, points))


def range_label_document(found: Found) -> dict[str, Any]:
    """Return the labels of points on a pattern in a dataset: their indices, and those of points on its border."""
    if not isinstance(found, PatternPoints):
        return {"detected": False, "idxs": [], "idxs_limit_points": []}
    return {"detected": True, "idxs": found.on_pattern.tolist(), "idxs_limit_points": found.on_border.tolist()}


def range_noise(sigma: float) -> float:
    """Return the standard deviation of a range (m), with a lower limit."""
    return max(sigma, _LEAST_RANGE_NOISE)


def meets(pattern: Pattern, T_sensor_pattern: Array, rays: Array) -> tuple[Array, BoolArray]:
    """Intersect rays (..., 3) from a sensor with the plane of a pattern.

    Returns:
        Distances (...) in lengths of the rays, and a mask (...) of those on the pattern.
    """
    normal, origin = T_sensor_pattern[:3, 2], T_sensor_pattern[:3, 3]
    (left, top), (right, bottom) = pattern.outline.min(0), pattern.outline.max(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: Array = (normal @ origin) / (rays @ normal)
        x, y = np.moveaxis((distance[..., None] * rays - origin) @ T_sensor_pattern[:3, :2], -1, 0)
        hits: BoolArray = (distance > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    return distance, hits
