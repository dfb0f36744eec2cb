"""Two sensors that keep their places against each other, and nothing else to calibrate."""

from calibration.dataset.model import Dataset, Sensor
from calibration.geometry.transforms import distance, inverse
from calibration.geometry.types import Array


def why_not_pair(dataset: Dataset, modalities: tuple[str, ...], wanted: str) -> str | None:
    """One line that says why the dataset is no such pair of these modalities; None if it is."""
    kinds = [f"'{s.name}' ({s.modality})" for s in dataset.sensors.values()]
    if len(dataset.sensors) != 2 or any(s.modality not in modalities for s in dataset.sensors.values()):
        return f"it needs {wanted} and no other sensor, and there are {', '.join(kinds)}"
    if dataset.additional_transforms:
        return f"it cannot calibrate additional transforms, such as '{'-'.join(dataset.additional_transforms[0])}'"
    first, second = dataset.sensors.values()
    T = dataset.transform(first.frame, second.frame)
    if max(values.max() for values in distance(T[:1], T)) > 1e-6:
        return f"it needs sensors that keep their places, and '{second.name}' moves against '{first.name}'"
    return None


def with_pair(dataset: Dataset, T_first_second: Array) -> Dataset:
    """The dataset with the pose (4, 4) between its sensors; the second one moves, unless it is anchored."""
    first, second = dataset.sensors.values()
    if dataset.anchored == second.name:
        first, second, T_first_second = second, first, inverse(T_first_second)
    return dataset.with_transforms({second.edge: _edge_transform(dataset, first, second, T_first_second)})


def _edge_transform(dataset: Dataset, reference: Sensor, sensor: Sensor, T_reference_sensor: Array) -> Array:
    """The sensor's calibrated transform (4, 4) that puts its data frame there against the reference's."""
    once = dataset.with_collections([0])
    T_parent_reference = once.transform(sensor.calibration_parent, reference.frame)[0]
    T_frame_child = once.transform(sensor.frame, sensor.calibration_child)[0]
    T: Array = T_parent_reference @ T_reference_sensor @ T_frame_child
    return T
