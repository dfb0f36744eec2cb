"""Pair of sensors of one kind with a constant relative pose; other sensors are left unchanged."""

from dataclasses import replace

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import MODALITIES, Modality
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.geometry.transforms import distance, inverse

Modalities = tuple[Modality, ...]
CAMERA_MODALITIES: Modalities = tuple(each for each in MODALITIES.values() if each.has_corners)
RANGE_SENSORS: Modalities = tuple(each for each in MODALITIES.values() if not each.has_corners and not each.is_planar)
"""Modalities whose views of a pattern are surface points."""


def pair_of(dataset: Dataset, modalities: Modalities) -> tuple[Sensor, Sensor]:
    """Return the two sensors of these modalities, in the dataset's order; check `why_not_pair` first."""
    first, second = _of_kind(dataset, modalities)
    return first, second


def only_pair(dataset: Dataset, modalities: Modalities) -> Dataset:
    """Remove all sensors but the two from a dataset."""
    pair = {sensor.name: sensor for sensor in pair_of(dataset, modalities)}
    return replace(dataset, sensors=pair, anchored=dataset.anchored if dataset.anchored in pair else None)


def why_not_pair(dataset: Dataset, modalities: Modalities, wanted: str) -> str | None:
    """Return the reason why the dataset has no such pair, in one line; None if it has."""
    if len(_of_kind(dataset, modalities)) != 2:
        kinds = ", ".join(f"'{s.name}' ({s.modality})" for s in dataset.sensors.values())
        return f"it needs two {wanted}, and there are {kinds}"
    if dataset.additional_transforms:
        return f"it cannot calibrate additional transforms, such as '{'-'.join(dataset.additional_transforms[0])}'"
    first, second = pair_of(dataset, modalities)
    T = dataset.transform(first.frame, second.frame)
    if max(values.max() for values in distance(T[:1], T)) > 1e-6:
        return f"it needs sensors that keep their places, and '{second.name}' moves against '{first.name}'"
    return None


def with_pair(dataset: Dataset, modalities: Modalities, T_first_second: Array) -> Dataset:
    """Set the relative pose (4, 4) of the two sensors in a dataset; the second one moves, unless it is anchored."""
    first, second = pair_of(dataset, modalities)
    if dataset.anchored == second.name:
        first, second, T_first_second = second, first, inverse(T_first_second)
    return dataset.with_transforms({second.edge: _edge_transform(dataset, first, second, T_first_second)})


def _of_kind(dataset: Dataset, modalities: Modalities) -> list[Sensor]:
    return [sensor for sensor in dataset.sensors.values() if sensor.modality in modalities]


def _edge_transform(dataset: Dataset, reference: Sensor, sensor: Sensor, T_reference_sensor: Array) -> Array:
    """Return the sensor's calibrated transform (4, 4) that yields this relative pose of its data frame."""
    once = dataset.with_collections([0])
    T_parent_reference = once.transform(sensor.calibration_parent, reference.frame)[0]
    T_frame_child = once.transform(sensor.frame, sensor.calibration_child)[0]
    T: Array = T_parent_reference @ T_reference_sensor @ T_frame_child
    return T
