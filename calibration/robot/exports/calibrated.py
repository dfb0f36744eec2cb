"""Calibrated part of a robot: the transforms, joints and cameras of a dataset that are exported."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import distance

SAME = 1e-9
"""m, rad: tolerance for a calibrated transform to be the same in all collections."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Calibrated transforms, joints and cameras of a robot."""

    name: str
    """Name of the system."""
    transforms: Mapping[Edge, Array]
    """``T_parent_child`` (4, 4) of sensors and additional transforms."""
    joints: Mapping[Edge, Array]
    """``T_parent_child`` (4, 4) of calibrated joints at position 0."""
    cameras: Mapping[str, Camera]
    frames: Mapping[str, str]
    """Frame of each camera's images."""
    poses: Mapping[str, Array]
    """``T_first_camera`` (4, 4) of each camera relative to the first one, if no moving transform is between them."""
    lags: Mapping[str, float] = field(default_factory=dict)
    """s: of the sensors that have one."""


def calibrated(dataset: Dataset) -> Calibrated:
    """Extract the calibrated transforms, joints and cameras from a dataset.

    Patterns are left out: they are not part of the robot.

    Raises:
        InputError: a calibrated transform is missing, or differs between collections.
    """
    joints = {joint.edge: joint.model.pose(joint.values) for joint in dataset.joints.values()}
    edges = dict.fromkeys([sensor.edge for sensor in dataset.sensors.values()])
    edges |= dict.fromkeys(dataset.additional_transforms)
    transforms = {}
    if not dataset.additional_transforms and set(edges) <= _origin(dataset):
        edges = {}  # cameras alone: what is calibrated is in the cameras
    for edge in edges:
        if edge in dataset.moving_transforms or edge in joints:
            continue
        T = dataset.transforms.get(edge)
        if T is None or not np.isfinite(T).all():
            raise InputError(f"{dataset.path}: no transform '{'-'.join(edge)}' in every collection; is it calibrated?")
        if _differs(T):
            raise InputError(
                f"{dataset.path}: found transforms '{'-'.join(edge)}' that differ between collections; expected a "
                f"calibrated dataset, which has the same in all"
            )
        transforms[edge] = T[0]
    cameras = {name: sensor.camera for name, sensor in dataset.sensors.items() if sensor.camera}
    frames = {name: dataset.sensors[name].frame for name in cameras}
    lags = {name: sensor.lag for name, sensor in dataset.sensors.items() if sensor.lag}
    poses = {}
    for name in cameras:
        T = dataset.transform(next(iter(frames.values())), frames[name])
        if not _differs(T):
            poses[name] = T[0]
    return Calibrated(dataset.name, transforms, joints, cameras, frames, poses, lags)


def _origin(dataset: Dataset) -> set[Edge]:
    """Return the transform of the anchored sensor, which is where the others are measured from."""
    return {dataset.sensors[dataset.anchored].edge} if dataset.anchored else set()


def _differs(T: Array) -> bool:
    """Whether transforms (N, 4, 4) differ between collections."""
    return bool(max(float(part.max()) for part in distance(T[0], T)) > SAME)
