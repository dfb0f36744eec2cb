"""What a dataset is: sensors, patterns, and collections of labels and transforms.

A `Dataset` is never changed; `Dataset.with_transforms` gives a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.modalities import Modality
from calibration.dataset.pattern import Pattern
from calibration.errors import InputError
from calibration.geometry.cameras import Camera
from calibration.geometry.frames import FrameTree
from calibration.geometry.joints import JointModel, JointParameter
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array, IntArray

Edge = tuple[str, str]
"""(parent, child); in a file it is the key ``parent-child``."""


@dataclass(frozen=True)
class Sensor:
    """A sensor and the transform that calibrates it."""

    name: str
    modality: Modality
    frame: str
    """The frame of its data."""
    calibration_parent: str
    calibration_child: str
    camera: Camera | None = None
    """The intrinsics, of a modality that has them."""

    @property
    def edge(self) -> Edge:
        """The calibrated transform, parent -> child; it lies somewhere on the way to `frame`."""
        return (self.calibration_parent, self.calibration_child)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of the robot of which some parameters are calibrated."""

    name: str
    edge: Edge
    """Its parent link and its child link."""
    model: JointModel
    parameters: tuple[JointParameter, ...]
    """To calibrate, in the order of `calibration.geometry.joints.JOINT_PARAMETERS`."""
    values: Array
    """(7,): all parameters, m and rad, in that order."""
    positions: Array
    """(N,): in each collection as the encoder has it, rad or m."""

    @property
    def transform(self) -> Array:
        """``T_parent_child`` (N, 4, 4)."""
        T: Array = self.model.pose(self.values) @ self.model.motion(self.positions)
        return T


@dataclass(frozen=True, eq=False)
class CornerLabels:
    """The corners that a camera detected in one collection."""

    ids: IntArray
    """(K,): ids of the pattern's corners, each once."""
    pixels: Array
    """(K, 2)."""


@dataclass(frozen=True, eq=False)
class PointLabels:
    """The points of a LiDAR or a depth camera that lie on the pattern in one collection."""

    points: Array
    """(N, 3): in the sensor's frame, m; of a 2D LiDAR in its plane z = 0."""
    limits: IntArray
    """(L,): which of `points` lie on the pattern's physical border: of a 2D LiDAR the ends of its cut."""


@dataclass(frozen=True, eq=False)
class PoseLabels:
    """The pose that a pattern was measured to have in one collection."""

    T: Array
    """(4, 4): ``T_sensor_pattern``, of the pattern's frame."""


Labels = CornerLabels | PointLabels | PoseLabels


def label_arrays(label: Labels) -> tuple[NDArray[Any], ...]:
    """All that a label says, to be hashed or compared."""
    match label:
        case CornerLabels():
            return label.ids, label.pixels
        case PointLabels():
            return label.points, label.limits
        case PoseLabels():
            return (label.T,)


def label_count(label: Labels) -> int:
    """How many labels there are: corners, points, or one pose."""
    match label:
        case CornerLabels():
            return len(label.ids)
        case PointLabels():
            return len(label.points)
        case PoseLabels():
            return 1


@dataclass(frozen=True, eq=False)
class Collection:
    """What all sensors saw at one moment. Sensors that did not detect a pattern are absent."""

    key: str
    labels: Mapping[tuple[str, str], Labels]
    """By (pattern, sensor)."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """A calibration dataset.

    Transforms are held edge by edge with the collections as batch axis, so that any chain of
    frames is one product for all collections.
    """

    path: Path
    """The file it was read from."""
    version: str
    """The version of the file, "2.0" or "3.0"."""
    world: str
    sensors: Mapping[str, Sensor]
    patterns: Mapping[str, Pattern]
    anchored: str | None
    """The sensor whose transform is given and stays as it is."""
    additional_transforms: tuple[Edge, ...]
    """Transforms to calibrate that belong to no sensor."""
    collections: tuple[Collection, ...]
    """In the order of their numbers, N of them."""
    transforms: Mapping[Edge, Array]
    """(N, 4, 4) for each edge: ``T_parent_child`` in each collection; NaN where a collection lacks it."""
    document: Mapping[str, Any]
    """The parsed JSON document, as it was read."""
    moving_transforms: frozenset[Edge] = frozenset()
    """Those of the additional transforms that each collection has its own of."""
    joints: Mapping[str, Joint] = field(default_factory=dict)
    """Joints of which parameters are calibrated, by name."""
    missing_files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By sensor: the files that its labels refer to and that are not there. These labels are left out, and a sensor
    that has no others is none of `sensors`."""

    @property
    def name(self) -> str:
        """The name of the dataset's folder."""
        return self.path.resolve().parent.name

    @cached_property
    def tree(self) -> FrameTree:
        """The frames of all collections."""
        return FrameTree(self.transforms)

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """The keys of the collections, such as "000"."""
        return tuple(collection.key for collection in self.collections)

    def transform(self, start: str, end: str) -> Array:
        """``T_start_end`` (N, 4, 4) in every collection.

        Raises:
            InputError: a frame is unknown, not connected, or a transform on the way is missing in a collection.
        """
        T = np.broadcast_to(np.eye(4), (len(self.collections), 4, 4))
        for step in self.tree.path(start, end):
            edge = self.transforms[step.parent, step.child]
            missing = np.isnan(edge[:, 0, 0])
            if missing.any():
                key = self.keys[int(missing.argmax())]
                raise InputError(f"{self.path}: collections/{key}/transforms: no '{step.parent}-{step.child}'")
            T = T @ (inverse(edge) if step.inverted else edge)
        return T

    def missing_files_of(self, sensor: str) -> str:
        """What is not there of a sensor, in words; empty where nothing is missing."""
        files = self.missing_files.get(sensor, ())
        if not files:
            return ""
        listed = ", ".join(files[:3]) + (f" and {len(files) - 3} more" if files[3:] else "")
        return f"{len(files)} data file{'s' if files[1:] else ''} of sensor '{sensor}' not found: {listed}"

    def detections(self, pattern: str, sensor: str) -> list[tuple[int, Labels]]:
        """The collections, by index, in which the sensor saw the pattern, with what it saw."""
        key = (pattern, sensor)
        return [(i, c.labels[key]) for i, c in enumerate(self.collections) if key in c.labels]

    def with_transforms(self, transforms: Mapping[Edge, Array]) -> "Dataset":
        """A new dataset with some edges replaced or added; each (4, 4), for all collections, or (N, 4, 4)."""
        shape = (len(self.collections), 4, 4)
        changed = {edge: np.broadcast_to(T, shape) for edge, T in transforms.items()}
        return replace(self, transforms={**self.transforms, **changed})

    def with_joints(self, values: Mapping[str, Array]) -> "Dataset":
        """A new dataset with the parameters (7,) of some joints replaced, and their transforms with them."""
        joints = {**self.joints, **{name: replace(self.joints[name], values=each) for name, each in values.items()}}
        moved = self.with_transforms({joints[name].edge: joints[name].transform for name in values})
        return replace(moved, joints=joints)

    def with_cameras(self, cameras: Mapping[str, Camera]) -> "Dataset":
        """A new dataset with the intrinsics of some sensors replaced."""
        changed = {name: replace(self.sensors[name], camera=camera) for name, camera in cameras.items()}
        return replace(self, sensors={**self.sensors, **changed})

    def with_collections(self, keep: Sequence[int]) -> "Dataset":
        """A new dataset with only the collections of these indices, in this order."""
        index = list(keep)
        return replace(
            self,
            collections=tuple(self.collections[i] for i in index),
            transforms={edge: T[index] for edge, T in self.transforms.items()},
            joints={name: replace(joint, positions=joint.positions[index]) for name, joint in self.joints.items()},
        )
