"""Data model of a dataset: sensors, patterns, and collections of labels and transforms.

A `Dataset` is immutable; `Dataset.with_transforms` returns a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.modalities import Modality
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree, JointModel, JointParameter
from calibration.engine.geometry.transforms import inverse, retract

ESTIMATED_KEY = "estimated_intrinsics"
"""Key of ``_metadata``: the cameras whose intrinsics are an initial guess from the corners."""
CHOSEN_MODELS = "chosen_lens_models"
"""Key of ``_metadata``: those of them whose lens model was chosen, and is that of the guess."""
ROUGH_KEY = "rough_transforms"
"""Key of ``_metadata``: whether the calibrated transforms in the dataset are only an initial guess."""
Edge = tuple[str, str]
"""(parent, child); in a file it is the key ``parent-child``."""


@dataclass(frozen=True, eq=False)
class LensUncertainty:
    """Covariance, or only standard deviations, of some intrinsics."""

    parameters: tuple[str, ...]
    """k of `calibration.engine.geometry.cameras.Camera.parameters`, in this order."""
    sigmas: Array
    """(k,): px, and 1; above 0."""
    covariance: Array | None = None
    """(k, k); None if only the standard deviations are known."""


@dataclass(frozen=True)
class Sensor:
    """Sensor with the transform that calibrates it."""

    name: str
    modality: Modality
    frame: str
    """Frame of its data."""
    calibration_parent: str
    calibration_child: str
    camera: Camera | None = None
    """Intrinsics, if its modality has them."""
    uncertainty: LensUncertainty | None = None
    """How well these are known, if the dataset says so."""
    lag: float = 0.0
    """s: time from a collection's transforms to what the sensor saw; positive if it saw them later."""

    @property
    def edge(self) -> Edge:
        """Calibrated transform, parent -> child; it is part of the chain to `frame`."""
        return (self.calibration_parent, self.calibration_child)


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint of the robot with calibrated parameters."""

    name: str
    edge: Edge
    """Parent link and child link."""
    model: JointModel
    parameters: tuple[JointParameter, ...]
    """Parameters to calibrate, in the order of `calibration.engine.geometry.frames.JOINT_PARAMETERS`."""
    values: Array
    """(7,): all parameters, m and rad, in that order."""
    positions: Array
    """(N,): encoder position in each collection, rad or m."""

    @property
    def transform(self) -> Array:
        """``T_parent_child`` (N, 4, 4)."""
        return self.model.pose(self.values) @ self.model.motion(self.positions)


@dataclass(frozen=True, eq=False)
class CornerLabels:
    """Corners that a camera detected in one collection."""

    ids: IntArray
    """(K,): ids of the pattern's corners, each once."""
    pixels: Array
    """(K, 2)."""


@dataclass(frozen=True, eq=False)
class PointLabels:
    """Points of a LiDAR or a depth camera on the pattern in one collection."""

    points: Array
    """(N, 3): in the sensor's frame, m; of a 2D LiDAR in its plane z = 0."""
    limits: IntArray
    """(L,): indices of the `points` on the pattern's physical border: of a 2D LiDAR the ends of the scan line."""


@dataclass(frozen=True, eq=False)
class PoseLabels:
    """Measured pose of a pattern in one collection."""

    T: Array
    """(4, 4): ``T_sensor_pattern``, of the pattern's frame."""


Labels = CornerLabels | PointLabels | PoseLabels


def label_arrays(label: Labels) -> tuple[NDArray[Any], ...]:
    """Return all numbers of a label."""
    return tuple(vars(label).values())


def label_count(label: Labels) -> int:
    """Return the number of corners or points of a label; 1 for a pose."""
    return 1 if isinstance(label, PoseLabels) else len(label_arrays(label)[0])


@dataclass(frozen=True, eq=False)
class Collection:
    """Labels of all sensors at one moment. Sensors without a detection are absent."""

    key: str
    labels: Mapping[tuple[str, str], Labels]
    """Labels by (pattern, sensor)."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Calibration dataset.

    Transforms are stored edge by edge with the collections as batch axis, so that any chain of
    frames is one product for all collections.
    """

    path: Path
    """File that it was read from."""
    version: str
    """Version of the file, "2.0" or "3.0"."""
    world: str
    sensors: Mapping[str, Sensor]
    patterns: Mapping[str, Pattern]
    anchored: str | None
    """Sensor with a given transform, which is not calibrated."""
    additional_transforms: tuple[Edge, ...]
    """Transforms to calibrate that do not belong to a sensor."""
    collections: tuple[Collection, ...]
    """The N collections, in the order of their numbers."""
    transforms: Mapping[Edge, Array]
    """(N, 4, 4) for each edge: ``T_parent_child`` in each collection; NaN where a collection lacks it."""
    document: Mapping[str, Any]
    """The parsed JSON document, unchanged."""
    moving_transforms: frozenset[Edge] = frozenset()
    """The additional transforms that differ between collections, each calibrated per collection."""
    joints: Mapping[str, Joint] = field(default_factory=dict)
    """Joints with calibrated parameters, by name."""
    velocities: Mapping[Edge, Array] = field(default_factory=dict)
    """(N, 6): velocity of the child of an edge at each collection, as a twist in the child's frame, m/s and rad/s."""
    accelerations: Mapping[Edge, Array] = field(default_factory=dict)
    """(N, 2, 6): acceleration and jerk of some of these, m/s^2 and m/s^3 ...; those of the others are 0."""
    missing_files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By sensor: missing files that its labels refer to. They are left out, as are sensors without others."""

    @property
    def name(self) -> str:
        """Name of the dataset's folder."""
        return self.path.resolve().parent.name

    @cached_property
    def tree(self) -> FrameTree:
        """Tree of the frames of all collections."""
        return FrameTree(self.transforms)

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Keys of the collections, such as "000"."""
        return tuple(collection.key for collection in self.collections)

    def transform(self, start: str, end: str, collections: IntArray | None = None) -> Array:
        """Return ``T_start_end`` (N, 4, 4) in every collection, or (V, 4, 4) in some, by their indices.

        Raises:
            InputError: a frame is unknown, not connected, or a transform between them is missing in a collection.
        """
        some = np.arange(len(self.collections)) if collections is None else collections
        T = np.broadcast_to(np.eye(4), (len(some), 4, 4))
        for step in self.tree.path(start, end):
            edge = self.transforms[step.parent, step.child]
            edge = edge if collections is None else edge[collections]
            missing = np.isnan(edge[:, 0, 0])
            if missing.any():
                key = self.keys[some[missing.argmax()]]
                raise InputError(f"{self.path}: collections/{key}/transforms: no '{step.parent}-{step.child}'")
            T = T @ (inverse(edge) if step.inverted else edge)
        return T

    @cached_property
    def guessed_cameras(self) -> tuple[str, ...]:
        """Cameras whose intrinsics are only an initial guess from the corners, as an import has made it."""
        return self._named_in_metadata(ESTIMATED_KEY)

    @cached_property
    def cameras_of_unknown_model(self) -> tuple[str, ...]:
        """Those of them whose lens model nobody has chosen."""
        return tuple(name for name in self.guessed_cameras if name not in self._named_in_metadata(CHOSEN_MODELS))

    def _named_in_metadata(self, key: str) -> tuple[str, ...]:
        named = self.document.get("_metadata", {}).get(key) or ()
        return tuple(name for name in self.sensors if name in named)

    def missing_files_of(self, sensor: str) -> str:
        """Describe the missing files of a sensor; empty if there are none."""
        files = self.missing_files.get(sensor, ())
        if not files:
            return ""
        listed = ", ".join(files[:3]) + (f" and {len(files) - 3} more" if files[3:] else "")
        return f"{len(files)} data file{'s' if files[1:] else ''} of sensor '{sensor}' not found: {listed}"

    def detections(self, pattern: str, sensor: str) -> list[tuple[int, Labels]]:
        """Return the collections, by index, in which the sensor saw the pattern, with the labels."""
        key = (pattern, sensor)
        return [(i, c.labels[key]) for i, c in enumerate(self.collections) if key in c.labels]

    def with_transforms(self, transforms: Mapping[Edge, Array]) -> "Dataset":
        """Return a new dataset with some edges replaced or added; each (4, 4), for all collections, or (N, 4, 4)."""
        shape = (len(self.collections), 4, 4)
        changed = {edge: T if T.shape == shape else np.broadcast_to(T, shape) for edge, T in transforms.items()}
        return replace(self, transforms={**self.transforms, **changed})

    def with_joints(self, values: Mapping[str, Array]) -> "Dataset":
        """Return a new dataset with the parameters (7,) of some joints, and so their transforms, replaced."""
        joints = {**self.joints, **{name: replace(self.joints[name], values=each) for name, each in values.items()}}
        moved = self.with_transforms({joints[name].edge: joints[name].transform for name in values})
        return replace(moved, joints=joints)

    def with_cameras(self, cameras: Mapping[str, Camera]) -> "Dataset":
        """Return a new dataset with the intrinsics of some sensors replaced."""
        changed = {name: replace(self.sensors[name], camera=camera) for name, camera in cameras.items()}
        return replace(self, sensors={**self.sensors, **changed})

    def with_lags(self, lags: Mapping[str, float]) -> "Dataset":
        """Return a new dataset with the lags (s) of some sensors replaced."""
        changed = {name: replace(self.sensors[name], lag=lag) for name, lag in lags.items()}
        return replace(self, sensors={**self.sensors, **changed})

    def moved_by_lag(self, sensor: str, edge: Edge, T: Array) -> Array:
        """Return transforms (N, 4, 4) of an edge, moved by its velocity to when a sensor with a lag saw them."""
        lag = self.sensors[sensor].lag
        if edge not in self.velocities or not lag:
            return T
        change = self._velocity_change(edge, lag / 2, lag**2 / 6)
        return retract(T, lag * (self.velocities[edge] + change))

    def velocities_seen_by(self, sensor: str) -> Mapping[Edge, Array]:
        """Return the velocities (N, 6) as they were when a sensor with a lag saw the frames."""
        lag = self.sensors[sensor].lag
        return {edge: each + self._velocity_change(edge, lag, lag**2 / 2) for edge, each in self.velocities.items()}

    def _velocity_change(self, edge: Edge, *factors: float) -> Array:
        """Return the change (N, 6) of a velocity: its acceleration and its jerk, each by a factor."""
        own = self.accelerations.get(edge)
        return np.zeros(6) if own is None else np.asarray(factors @ own)

    def seen_by(self, sensor: str) -> "Dataset":
        """Return the dataset with all transforms as they were when a sensor with a lag saw them."""
        if not self.sensors[sensor].lag:
            return self
        edges = self.velocities.keys() & self.transforms.keys()
        return self.with_transforms({edge: self.moved_by_lag(sensor, edge, self.transforms[edge]) for edge in edges})

    def with_collections(self, keep: Sequence[int]) -> "Dataset":
        """Return a new dataset with only the collections of these indices, in this order."""
        index = list(keep)
        return replace(
            self,
            collections=tuple(self.collections[i] for i in index),
            transforms={edge: T[index] for edge, T in self.transforms.items()},
            joints={name: replace(joint, positions=joint.positions[index]) for name, joint in self.joints.items()},
            velocities={edge: v[index] for edge, v in self.velocities.items()},
            accelerations={edge: each[index] for edge, each in self.accelerations.items()},
        )
