"""Sensors and patterns of a dataset by name; the errors list the known names."""

from collections.abc import Iterable

from calibration.base.errors import InputError
from calibration.engine.dataset.modalities import Modality, of_family
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.cameras import Camera


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
