"""What every simulated sensor can do: read its description, measure, label, and predict its labels."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.modalities import Modality, NoiseKind
from calibration.dataset.model import CornerLabels, Labels, PointLabels
from calibration.dataset.pattern import Pattern
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray
from calibration.labelling.detection import Image, NotDetected
from calibration.labelling.points import PatternPoints
from calibration.simulation.board import Board
from calibration.simulation.scene import Scene

MAX_VIEW_ANGLE = math.radians(65)
"""Between the pattern's normal and the line of sight: beyond it detectors lose more and more of a pattern."""


def facing(T_sensor_pattern: Array, centre: Array) -> BoolArray:
    """Which poses (..., 4, 4) show the sensor the front of the pattern, within `MAX_VIEW_ANGLE`.

    The pattern's z axis points away from a sensor that sees it; centre (3,) is in the pattern's frame.
    """
    sensor = inverse(T_sensor_pattern)[..., :3, 3] - centre
    front: BoolArray = -sensor[..., 2] > math.cos(MAX_VIEW_ANGLE) * np.linalg.norm(sensor, axis=-1)
    return front


def corners_in_image(camera: Camera, points: Array) -> tuple[Array, BoolArray]:
    """Pixels (..., K, 2) of points (..., K, 3) in the camera frame, and which of them (..., K) are on the image."""
    pixels, visible = camera.project_visible(points)
    return pixels, visible & camera.contains(pixels)


Data = NDArray[Any]
"""What a sensor measures at one pose; each modality has its own shape and unit."""
Found = CornerLabels | PatternPoints | NotDetected
"""What a detector says of one pattern in a sensor's data."""
LEAST_SHARE = 0.5
"""Of a pattern's corners: a view of fewer says little, and a detector may miss it."""
_LEAST_RANGE_NOISE = 1e-4  # m: a sensor without noise would weigh infinitely much


@dataclass(frozen=True, eq=False)
class Views:
    """A pattern before a sensor at N poses."""

    configuration: PatternConfiguration
    pattern: Pattern
    scene: Scene
    """What may stand between the two."""
    T_world_sensor: Array
    """(N, 4, 4)."""
    T_world_pattern: Array
    """(N, 4, 4)."""

    @cached_property
    def T_sensor_pattern(self) -> Array:
        """(N, 4, 4)."""
        return inverse(self.T_world_sensor) @ self.T_world_pattern

    def hidden(self, points: Array) -> BoolArray:
        """Which points (K, 3) in the pattern's frame have something between them and the sensor: (N, K)."""
        return self.scene.hides(self.T_world_sensor[:, :3, 3], apply(self.T_world_pattern, points))


class SimulatedSensor(ABC):
    """A sensor of one modality, as ``simulation.yml`` describes it; every class of sensors is a record."""

    modality: ClassVar[Modality]
    label_name: ClassVar[str]
    """What one sees counted of its labels: "corners"."""
    file_ending: ClassVar[str | None] = None
    """Of the files with its data; None where they stand in the dataset's JSON."""
    scenario_group: ClassVar[str | None] = None
    """The key of a scenario set that speaks of all sensors of this kind; None where there is none."""

    noise: float
    """The standard deviation of what it measures: grey levels of an image, m of a range."""

    @abstractmethod
    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """The sensor with values of a scenario's parameters; ``name`` is for messages.

        Raises:
            InputError: it has no such parameter.
        """

    @property
    def intrinsics(self) -> Camera | None:
        """Those of a sensor with an image."""
        return None

    @abstractmethod
    def render(self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator) -> Data:
        """What the sensor measures.

        Args:
            T_world_sensor: (4, 4), to the frame of its data.
            scene: what stands around, and the light.
            boards: the patterns.
            random: gives one number for each pixel or ray, whatever it sees.
        """

    @abstractmethod
    def message(self, data: Data) -> dict[str, Any]:
        """The fields of the ROS message in a dataset, but for its header and the name of the file with the data."""

    def encode(self, data: Data) -> bytes:
        """The content of the file with the data, where there is one."""
        raise AssertionError(f"the data of {self.modality} sensors are in no file")

    @abstractmethod
    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Detect a pattern, which is about at ``T_sensor_pattern`` (4, 4) as far as a collector can know."""

    @abstractmethod
    def label_document(self, found: Found) -> dict[str, Any]:
        """The labels of one pattern in a dataset."""

    def points(self, data: Data) -> Array | None:
        """The points (N, 3) in the sensor's frame, m, NaN where nothing came back; None where the data are an image."""
        del data
        return None

    @abstractmethod
    def detects(self, views: Views) -> BoolArray:
        """At which poses (N,) a detector would surely find the pattern."""

    @abstractmethod
    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """The exact labels, by the index of those poses at which the pattern is detected."""

    @abstractmethod
    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """The standard deviations (px, m, rad) that its labels of a pattern at a distance (m) will have."""

    @abstractmethod
    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """A small picture of what it saw at a pose, with the labels in it; grey where its data cannot be read.

        Args:
            message: of the sensor, in the dataset.
            labels: of each pattern, as `label_document`.
            patterns: those patterns.
            files: the folder with the files that the message names.
        """


class RangeSensor(SimulatedSensor):
    """A sensor that measures how far away things are."""

    reach: tuple[float, float]
    """The least and the largest range, m; a surface nearer or farther gives nothing."""

    @property
    def least_range(self) -> float:
        """m; a surface nearer than that gives nothing."""
        return self.reach[0]

    @property
    def most_range(self) -> float:
        """m; a surface farther than that gives nothing."""
        return self.reach[1]

    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """With another noise."""
        del name
        return replace(self, noise=values["noise_m"]) if "noise_m" in values else self  # type: ignore[type-var]

    def label_document(self, found: Found) -> dict[str, Any]:
        """The indices of the points on the pattern, and of those on its border."""
        if not isinstance(found, PatternPoints):
            return {"detected": False, "idxs": [], "idxs_limit_points": []}
        return {
            "detected": True,
            "idxs": found.on_pattern.tolist(),
            "idxs_limit_points": found.on_border.tolist(),
        }

    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """The points on the pattern, and which are on its border."""
        return {number: self.points_on(views, number) for number in np.flatnonzero(self.detects(views)).tolist()}

    @abstractmethod
    def points_on(self, views: Views, number: int) -> PointLabels:
        """Where the sensor's rays meet the pattern in one of the views, by its index."""

    def visible(self, views: Views, number: int, points: Array, ranges: Array) -> BoolArray:
        """Which points (K, 3) in the sensor's frame are within range (ranges: (K,)) and not hidden in a view."""
        T_world_sensor = views.T_world_sensor[number]
        visible: BoolArray = (ranges >= self.least_range) & (ranges <= self.most_range)
        return visible & ~views.scene.hides(T_world_sensor[:3, 3], apply(T_world_sensor, points))


def range_noise(sigma: float) -> float:
    """The standard deviation of a range (m) that a labelled point is given at least."""
    return max(sigma, _LEAST_RANGE_NOISE)


def meets(pattern: Pattern, T_sensor_pattern: Array, rays: Array) -> tuple[Array, BoolArray]:
    """Where rays (..., 3) from a sensor meet the plane of a pattern, and which do so on the pattern.

    Returns:
        Distances (...) in lengths of the rays, and which of them (...) are hits.
    """
    normal, origin = T_sensor_pattern[:3, 2], T_sensor_pattern[:3, 3]
    (left, top), (right, bottom) = pattern.outline.min(0), pattern.outline.max(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: Array = (normal @ origin) / (rays @ normal)
        x, y = np.moveaxis((distance[..., None] * rays - origin) @ T_sensor_pattern[:3, :2], -1, 0)
        hits: BoolArray = (distance > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    return distance, hits
