"""Views of sensors, chosen by name, with the pose that each determines alone, and pairs of them to compare."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.modalities import Modality, of_family
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, PointLabels, PoseLabels, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse, translation


def sensor_of(dataset: Dataset, name: str) -> Sensor:
    """Return the sensor with this name.

    Raises:
        InputError: the dataset has none.
    """
    if missing := name not in dataset.sensors and dataset.missing_files_of(name):
        raise InputError(f"{dataset.path}: {missing}; put them beside it, or leave '{name}' out")
    if name not in dataset.sensors:
        raise InputError(f"{dataset.path}: no sensor '{name}' (sensors: {_joined_names(dataset.sensors)})")
    return dataset.sensors[name]


def camera_of(dataset: Dataset, name: str) -> tuple[Sensor, Camera]:
    """Return the camera with this name, and its intrinsics.

    Raises:
        InputError: the dataset has no such sensor, or it is not a camera.
    """
    return _with_intrinsics(dataset, name, of_family("camera"))


def lidar_of(dataset: Dataset, name: str) -> Sensor:
    """Return the LiDAR with this name, 2D or 3D.

    Raises:
        InputError: the dataset has no such sensor, or it is not a LiDAR.
    """
    return _of_modality(dataset, name, of_family("lidar"))


def lidar3d_of(dataset: Dataset, name: str) -> Sensor:
    """Return the 3D LiDAR with this name.

    Raises:
        InputError: the dataset has no such sensor, or it is not a 3D LiDAR.
    """
    return _of_modality(dataset, name, tuple(each for each in of_family("lidar") if not each.is_planar))


def depth_of(dataset: Dataset, name: str) -> tuple[Sensor, Camera]:
    """Return the depth camera with this name, and its intrinsics.

    Raises:
        InputError: the dataset has no such sensor, or it is not a depth camera.
    """
    return _with_intrinsics(dataset, name, of_family("depth camera"))


def tracker_of(dataset: Dataset, name: str) -> Sensor:
    """Return the sensor with this name, whose labels are poses.

    Raises:
        InputError: the dataset has no such sensor, or its labels are not poses.
    """
    return _of_modality(dataset, name, of_family("tracker"))


def _with_intrinsics(dataset: Dataset, name: str, modalities: tuple[Modality, ...]) -> tuple[Sensor, Camera]:
    sensor = _of_modality(dataset, name, modalities)
    if sensor.camera is None:
        raise InputError(f"{dataset.path}: sensor '{name}' has no intrinsics")
    return sensor, sensor.camera


def _of_modality(dataset: Dataset, name: str, modalities: tuple[Modality, ...]) -> Sensor:
    sensor = sensor_of(dataset, name)
    if sensor.modality not in modalities:
        others = (s.name for s in dataset.sensors.values() if s.modality in modalities)
        wanted = " or ".join(map(str, modalities))
        raise InputError(
            f"{dataset.path}: sensor '{name}' is {sensor.modality}, not {wanted} ({wanted}: {_joined_names(others)})"
        )
    return sensor


def pattern_of(dataset: Dataset, name: str | None) -> Pattern:
    """Return the pattern with this name; without a name, the only one.

    Raises:
        InputError: the dataset has no such pattern, or several to choose from.
    """
    if name is None:
        if len(dataset.patterns) != 1:
            raise InputError(f"{dataset.path}: say which pattern (patterns: {_joined_names(dataset.patterns)})")
        return next(iter(dataset.patterns.values()))
    if name not in dataset.patterns:
        raise InputError(f"{dataset.path}: no pattern '{name}' (patterns: {_joined_names(dataset.patterns)})")
    return dataset.patterns[name]


def _joined_names(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


@dataclass(frozen=True, eq=False)
class CornerViews:
    """V views of a pattern with K corners by a camera. Unseen corners are zero."""

    collections: IntArray
    """(V,): index of each view's collection, ascending."""
    pixels: Array
    """(V, 2, K): the labels."""
    rays: Array
    """(V, 3, K): their rays, of any length."""
    seen: BoolArray
    """(V, K)."""
    T_camera_pattern: Array
    """(V, 4, 4): least squares on each view alone."""
    left_out: tuple[str, ...]
    """Views from which no pose can be estimated."""

    def __getitem__(self, views: IntArray) -> "CornerViews":
        """Return some of the views, by their rows."""
        arrays = ("collections", "pixels", "rays", "seen", "T_camera_pattern")
        return replace(self, **{name: getattr(self, name)[views] for name in arrays})


@dataclass(frozen=True, eq=False)
class MeasuredViews:
    """V measured poses of a pattern."""

    collections: IntArray
    """(V,): index of each pose's collection, ascending."""
    T_camera_pattern: Array
    """(V, 4, 4)."""


def measured_views(dataset: Dataset, sensor: str, pattern: Pattern) -> MeasuredViews:
    """Return the labels of a sensor that are poses."""
    found = [(i, label.T) for i, label in dataset.detections(pattern.name, sensor) if isinstance(label, PoseLabels)]
    poses = np.array([T for _, T in found]).reshape(-1, 4, 4)
    return MeasuredViews(np.array([i for i, _ in found], int), poses)


def corner_views(dataset: Dataset, sensor: str, pattern: Pattern) -> CornerViews:
    """Return the views of a camera from which the pose of the pattern can be estimated.

    They do not depend on the dataset's transforms, so the results for the last few datasets are cached.

    Raises:
        InputError: there is no such camera.
    """
    _, camera = camera_of(dataset, sensor)
    return _corner_views(dataset.collections, sensor, camera, pattern)


@lru_cache(maxsize=8)
def _corner_views(collections: tuple[Collection, ...], sensor: str, camera: Camera, pattern: Pattern) -> CornerViews:
    """Cache of `corner_views`, keyed by immutable collections and patterns, which compare by identity."""
    labels = ((i, collection.labels.get((pattern.name, sensor))) for i, collection in enumerate(collections))
    detections = [(i, label) for i, label in labels if isinstance(label, CornerLabels)]
    term = corner_term(camera, pattern, [label for _, label in detections])
    seen = np.ones((len(detections), len(pattern.corners)), bool) if term.seen is None else term.seen
    rays = np.where(seen[:, None], np.swapaxes(camera.distortion.chart.rays(*np.swapaxes(term.rays, 0, 1)), 0, 1), 0.0)
    T_camera_centre, _ = fitted_poses(term)
    T = T_camera_centre @ inverse(translation(pattern.centre))
    good = np.isfinite(T[:, 0, 0])
    left_out = tuple(
        f"{collections[i].key}: the {len(label.ids)} corners that {sensor} sees do not give a pose"
        for (i, label), usable in zip(detections, good, strict=True)
        if not usable
    )
    arrays = np.array([i for i, _ in detections], int)[good], term.pixels[good], rays[good], seen[good], T[good]
    for array in arrays:
        array.flags.writeable = False
    return CornerViews(*arrays, left_out)


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of views, by the indices of their collections."""

    source: IntArray
    """(P,)."""
    target: IntArray
    """(P,)."""
    T_target_source: Array
    """(P, 4, 4): between the sensors' data frames."""
    names: list[str]
    """``000`` of one collection, ``000-001`` of two."""

    def __iter__(self) -> Iterator[tuple[int, int, Array, str]]:
        return zip(self.source.tolist(), self.target.tolist(), self.T_target_source, self.names, strict=True)


def point_views(dataset: Dataset, sensor: Sensor, pattern: Pattern) -> dict[int, PointLabels]:
    """Return a sensor's points on a pattern by the index of the collection."""
    seen = dataset.detections(pattern.name, sensor.name)
    return {i: label for i, label in seen if isinstance(label, PointLabels) and len(label.points)}


def same_collection(dataset: Dataset, source: Sensor, target: Sensor, seen: Sequence[int]) -> Pairs:
    """Return the views of two sensors in each of these collections.

    Raises:
        InputError: the sensors are identical (nothing would be tested), or a transform is missing.
    """
    if source.name == target.name:
        raise InputError(
            f"'{source.name}' against itself tests nothing in one collection: use an inter-collection table"
        )
    index = np.array(seen, int)
    T_target_source = dataset.with_collections(list(seen)).transform(target.frame, source.frame)
    return Pairs(index, index, T_target_source, [dataset.keys[i] for i in seen])


def between_collections(
    dataset: Dataset,
    sensors: tuple[Sensor, Sensor],
    pattern: Pattern,
    seen: tuple[Sequence[int], Sequence[int]],
    target_first: bool = False,
) -> Pairs:
    """Return all pairs of a view of the first sensor and a view of the second, related by the pattern's parent link.

    As in ATOM this includes pairs from one collection, except for a sensor with itself, which
    is compared once for each unordered pair of different collections. They are sorted, and named, by the collection of
    the first sensor, or of the second with ``target_first``.

    Raises:
        InputError: the pattern is not fixed, or a transform is missing.
    """
    require_fixed(dataset, pattern)
    a, b = (np.array(indices, int) for indices in seen)
    later = a[:, None] < b[None]
    i, j = np.nonzero(later if sensors[0].name == sensors[1].name else np.ones_like(later))
    if target_first:
        order = np.lexsort((a[i], b[j]))
        i, j = i[order], j[order]
    ends = (b[j], a[i]) if target_first else (a[i], b[j])
    T_parent_source, T_parent_target = (
        dataset.with_collections(list(indices)).transform(pattern.parent_link, sensor.frame)
        for sensor, indices in zip(sensors, seen, strict=True)
    )
    names = [f"{dataset.keys[m]}-{dataset.keys[n]}" for m, n in zip(*ends, strict=True)]
    return Pairs(a[i], b[j], inverse(T_parent_target)[j] @ T_parent_source[i], names)


def require_fixed(dataset: Dataset, pattern: Pattern) -> None:
    """Raise if a pattern moves.

    Raises:
        InputError: it moves.
    """
    if not pattern.fixed:
        raise InputError(
            f"{dataset.path}: pattern '{pattern.name}' is not fixed: its collections cannot be compared with each other"
        )
