"""Ground truth of a dataset: the values that a calibration should find, and the errors of those that it has found.

Errors are up to the gauge of the calibration (`truth_error`), or of chains of frames in ATOM's form: its evaluations
``ground_truth_transform`` and ``ground_truth_frame``. ATOM reports the mean of the signed
coordinates as translation error (0 for 10 mm along x and -10 along y) and the mean of three Euler
angles as rotation error; here these columns are the norm and the angle. Unobservable parts of the error
(gauge freedom) are not removed there.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, read_json
from calibration.engine.dataset.edges import read_transform
from calibration.engine.dataset.model import Dataset, Edge, Joint, Sensor
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.evaluation.views import sensor_of
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointParameter
from calibration.engine.geometry.transforms import distance, inverse

TRUTH_FILE = "ground_truth.json"


@dataclass(frozen=True, eq=False)
class Truth:
    """True transforms, each ``T_parent_child`` (4, 4)."""

    path: Path
    """File that it was read from."""
    sensors: Mapping[str, Edge]
    """Calibrated transform of each sensor."""
    transforms: Mapping[Edge, Array]
    """Transforms that are the same in all collections: of sensors, fixed patterns, additional transforms."""
    patterns: Mapping[str, Mapping[Edge, Array]]
    """Transforms that differ between collections, by the collection's key: poses of patterns and others."""
    joints: Mapping[str, Mapping[JointParameter, float]] = field(default_factory=dict)
    """Calibrated parameters of each joint by name, m and rad."""


def read_truth(path: Path | str) -> Truth:
    """Read the truth from a file: ``sensors`` by name, ``patterns`` by collection, ``pattern`` if it is fixed.

    A file may also have ``transforms``, a list of further transforms that are the same in all
    collections; in ``patterns`` a list for each collection if there are several, other transforms that
    differ between collections among them; and ``joints``, by name the parameters that are calibrated.

    Raises:
        InputError: the file cannot be read, or something in it is missing or wrong.
    """
    path = Path(path)
    root = read_json(path)
    sensors = {name: read_transform(node) for name, node in root["sensors"].items()}
    constant, joints = dict(sensors.values()), root.get("joints")
    if fixed := root.get("pattern"):
        constant.update([read_transform(fixed)])
    if others := root.get("transforms"):
        constant.update(read_transform(node) for node in others.elements())
    patterns = {}
    if by_collection := root.get("patterns"):
        for key, node in by_collection.items():
            several = node.elements() if isinstance(node.value, list) else [node]
            patterns[key] = dict(read_transform(each) for each in several)
    return Truth(
        path=path,
        sensors={name: edge for name, (edge, _) in sensors.items()},
        transforms=constant,
        patterns=patterns,
        joints={name: _joint_parameters(node) for name, node in joints.items()} if joints else {},
    )


def _joint_parameters(node: Node) -> dict[JointParameter, float]:
    values = {name: value.number() for name, value in node.items()}
    for name in values:
        if name not in JOINT_PARAMETERS:
            raise node[name].fault(f"there is no parameter '{name}', expected one of {', '.join(JOINT_PARAMETERS)}")
    return {parameter: values[parameter] for parameter in JOINT_PARAMETERS if parameter in values}


def choose_truth(dataset: Dataset, choice: str | None) -> Truth | None:
    """Return the truth that the user has chosen for a dataset: a file, "dataset" for the transforms in it, "none".

    None means ``ground_truth.json`` beside the dataset, if it exists.

    Raises:
        InputError: the file is wrong, or has other transforms than those the dataset calibrates.
    """
    if choice is None:
        return find_truth(dataset)
    if choice == "dataset":
        return truth_of(dataset)
    return None if choice == "none" else read_truth(Path(choice))


def find_truth(dataset: Dataset) -> Truth | None:
    """Read the truth from ``ground_truth.json`` beside the dataset; None if there is no such file.

    Raises:
        InputError: the file is wrong, or has other transforms than those the dataset calibrates.
    """
    path = dataset.path.parent / TRUTH_FILE
    if not path.exists():
        return None
    truth = read_truth(path)
    for name, sensor in dataset.sensors.items():
        if sensor.edge not in truth.transforms:
            expected = f"that of '{'-'.join(sensor.edge)}', which sensor '{name}' calibrates"
            raise Node(path, ("sensors",), None).fault(f"missing transform, expected {expected}")
    for name, joint in dataset.joints.items():
        missing = [parameter for parameter in joint.parameters if parameter not in truth.joints.get(name, {})]
        if missing:
            raise Node(path, ("joints", name), None).fault(f"missing '{missing[0]}', which the dataset calibrates")
    return truth


def truth_of(dataset: Dataset) -> Truth:
    """Return the transforms and joints of a dataset as the truth, as in ATOM's simulations.

    Raises:
        InputError: a calibrated transform differs between collections.
    """
    sensors = {name: sensor.edge for name, sensor in dataset.sensors.items()}
    constant = {}
    for edge in (*sensors.values(), *(e for e in dataset.additional_transforms if e not in dataset.moving_transforms)):
        T = dataset.transforms[edge]
        different = (abs(T - T[0]) > 1e-9).any((1, 2))
        if different.any():
            key = dataset.keys[int(different.argmax())]
            node = Node(dataset.path, ("collections", key, "transforms", "-".join(edge)), None)
            raise node.fault(f"differs from collection {dataset.keys[0]}; a transform to calibrate is the same in all")
        constant[edge] = T[0]
    patterns: dict[str, dict[Edge, Array]] = {key: {} for key in dataset.keys}
    for pattern in dataset.patterns.values():
        edge = pattern.edge
        for key, T in zip(dataset.keys, dataset.transforms.get(edge, ()), strict=False):
            if np.isfinite(T).all():
                patterns[key][edge] = T
                if pattern.fixed:
                    constant.setdefault(edge, T)
    joints = {
        name: {p: float(joint.values[JOINT_PARAMETERS.index(p)]) for p in joint.parameters}
        for name, joint in dataset.joints.items()
    }
    return Truth(dataset.path, sensors, constant, patterns, joints=joints)


@dataclass(frozen=True)
class PoseError:
    """Error of one pose against the true one."""

    name: str
    """A sensor, or two: ``left_camera/right_camera``."""
    translation_mm: float
    """Norm of the difference in position."""
    rotation_deg: float
    """Angle between the orientations."""


@dataclass(frozen=True)
class JointError:
    """Error of one parameter of a joint against the true one."""

    joint: str
    parameter: JointParameter
    error: float
    """Absolute difference, rad or m."""
    unit: Literal["m", "rad"]


@dataclass(frozen=True)
class TruthError:
    """Errors of a calibration: of each calibrated sensor, or of each pair if only relative poses are observable."""

    poses: tuple[PoseError, ...]
    joints: tuple[JointError, ...] = ()
    """Error of each calibrated parameter of a joint."""

    @property
    def translation_mm(self) -> float:
        """Maximum of all."""
        return max(pose.translation_mm for pose in self.poses)

    @property
    def rotation_deg(self) -> float:
        """Maximum of all, not necessarily of the same pose."""
        return max(pose.rotation_deg for pose in self.poses)

    @property
    def joint_mm(self) -> float | None:
        """Maximum of the joint parameters that are lengths; None without any."""
        return max((1000 * each.error for each in self.joints if each.unit == "m"), default=None)

    @property
    def joint_deg(self) -> float | None:
        """Maximum of the joint parameters that are angles; None without any."""
        return max((float(np.degrees(each.error)) for each in self.joints if each.unit == "rad"), default=None)


def truth_error(dataset: Dataset, truth: Truth) -> TruthError:
    """Return the errors of the calibrated transforms, up to the gauge of the calibration.

    If none of two or more sensors is anchored, a common motion of all is unobservable: the relative pose of the
    data frames of every pair is compared, from either side, and the larger error counts. Otherwise
    each sensor's calibrated transform is compared, except the anchored one unless it is the only one and joints are
    calibrated. Of the collections with labels the largest error counts, should a chain differ between them.

    Raises:
        InputError: the truth lacks a sensor or a joint, something is missing or not finite, or nothing is calibrated.
    """
    labelled = [i for i, c in enumerate(dataset.collections) if c.labels]
    if not labelled:
        raise InputError(f"{dataset.path}: no collection has labels: nothing is calibrated")
    found = dataset.with_collections(labelled)
    return error_against(found, with_true_values(found, truth), relative=dataset.anchored is None)


def with_true_values(dataset: Dataset, truth: Truth) -> Dataset:
    """Return a dataset with the true transforms of its sensors, and the true values of its calibrated joints.

    Raises:
        InputError: the truth lacks one.
    """
    sensors = list(dataset.sensors.values())
    missing = [s for s in sensors if s.edge not in truth.transforms]
    if missing:
        raise InputError(f"{truth.path}: sensor '{missing[0].name}': no true transform '{'-'.join(missing[0].edge)}'")
    joints = {name: _true_values(joint, truth) for name, joint in dataset.joints.items()}
    return dataset.with_transforms({s.edge: truth.transforms[s.edge] for s in sensors}).with_joints(joints)


def error_against(found: Dataset, true: Dataset, relative: bool) -> TruthError:
    """Return the errors of a dataset's sensors and joints against those of another one with the same collections.

    Args:
        found: the dataset to judge.
        true: the reference.
        relative: compare the relative pose of the data frames of every two sensors, if there are two.

    Raises:
        InputError: something is missing or not finite, or nothing is calibrated.
    """
    sensors = list(found.sensors.values())
    of_joints = tuple(
        error for name in true.joints for error in _of_joint(found.joints[name], true.joints[name].values)
    )
    if relative and len(sensors) > 1:
        return TruthError(tuple(_error_between(a, b, found, true) for a, b in combinations(sensors, 2)), of_joints)
    calibrated = [s for s in sensors if s.name != found.anchored] or (sensors if of_joints else [])
    if not calibrated:
        raise InputError(f"{found.path}: only sensor '{found.anchored}', and it is anchored: nothing is calibrated")
    poses = tuple(_worst_error(s.name, true.transform(*s.edge), found.transform(*s.edge)) for s in calibrated)
    return TruthError(poses, of_joints)


def _true_values(joint: Joint, truth: Truth) -> Array:
    """Return all parameters (7,) of a joint, with the true values of the calibrated ones."""
    values, true = joint.values.copy(), truth.joints.get(joint.name, {})
    for parameter in joint.parameters:
        if parameter not in true:
            raise InputError(f"{truth.path}: joint '{joint.name}': no true '{parameter}'")
        values[JOINT_PARAMETERS.index(parameter)] = true[parameter]
    return values


def _of_joint(joint: Joint, true: Array) -> Iterator[JointError]:
    """Return the errors of the calibrated parameters, given all true ones (7,)."""
    for parameter in joint.parameters:
        at, unit = JOINT_PARAMETERS.index(parameter), joint.model.unit(parameter)
        difference = float(joint.values[at] - true[at])
        error = abs(difference if unit == "m" else math.remainder(difference, math.tau))
        if not math.isfinite(error):
            raise InputError(f"'{parameter}' of joint '{joint.name}' is not finite: its error is undefined")
        yield JointError(joint.name, parameter, error, unit)


def _error_between(a: Sensor, b: Sensor, found: Dataset, true: Dataset) -> PoseError:
    """Return the larger error of the relative pose of two data frames, seen from either."""
    T_true, T_found = (dataset.transform(a.frame, b.frame) for dataset in (true, found))
    both = np.concatenate([T_true, inverse(T_true)]), np.concatenate([T_found, inverse(T_found)])
    return _worst_error(f"{a.name}/{b.name}", *both)


def _worst_error(name: str, T_true: Array, T_found: Array) -> PoseError:
    if not (np.isfinite(T_true).all() and np.isfinite(T_found).all()):
        raise InputError(f"a transform of {name} is not finite: its error is undefined")
    translation, angle = distance(T_true, T_found)
    return PoseError(name, float(1000 * translation.max()), float(np.degrees(angle.max())))


GROUND_TRUTH_COLUMNS = ("Trans (m)", "Rot (rad)", "X (m)", "Y (m)", "Z (m)", "Roll (rad)", "Pitch (rad)", "Yaw (rad)")
TRANSFORMATION_HEADER = "Transformation #"


def ground_truth_transform(dataset: Dataset, truth: Truth | None, parent: str, child: str) -> Table:
    """Return the error of one frame's pose in another in each collection, expressed in the true child frame.

    Columns: the norm (m) and the angle (rad) of the error; its coordinates, and roll, pitch, yaw about fixed axes.

    Args:
        dataset: the transforms to evaluate.
        truth: the true transforms.
        parent: parent frame.
        child: child frame; the truth must have a transform on the path.

    Raises:
        InputError: there is no truth, or none on the path; a frame is unknown or not connected.
    """
    return Table(COLLECTION_HEADER, GROUND_TRUTH_COLUMNS, dataset.keys, _error_columns(dataset, truth, parent, child))


def ground_truth_frame(dataset: Dataset, truth: Truth | None, frame: str, sensor: str | None = None) -> Table:
    """Return the errors of the calibrated frames, as seen from a frame.

    With a sensor this is `ground_truth_transform` from the frame to that sensor's calibrated child. Without one
    there is a row for each sensor and additional transform: the means of the absolute values over the collections.

    Raises:
        InputError: as `ground_truth_transform`, or there is no such sensor.
    """
    if sensor is not None:
        return ground_truth_transform(dataset, truth, frame, sensor_of(dataset, sensor).calibration_child)
    children = {name: s.calibration_child for name, s in dataset.sensors.items() if name != dataset.anchored}
    children |= {"-".join(edge): edge[1] for edge in dataset.additional_transforms}
    rows = {name: _error_columns(dataset, truth, frame, child) for name, child in children.items()}
    if not rows:
        raise InputError(f"{dataset.path}: nothing is calibrated")
    values = np.stack([np.abs(errors).mean(0) for errors in rows.values()])
    return Table(TRANSFORMATION_HEADER, GROUND_TRUTH_COLUMNS, tuple(rows), values)


def _error_columns(dataset: Dataset, truth: Truth | None, parent: str, child: str) -> Array:
    """Return the columns (N, 8)."""
    if truth is None:
        raise InputError(f"{dataset.path}: there is no truth to compare with (ground_truth.json beside it, or 'truth')")
    true = _true_transforms(dataset, truth)
    way = {(step.parent, step.child) for step in dataset.tree.path(parent, child)}
    if not way & set(true):
        raise InputError(f"{truth.path}: no true transform on the way from '{parent}' to '{child}'")
    T_true, T_found = (d.transform(parent, child) for d in (dataset.with_transforms(true), dataset))
    error = inverse(T_true) @ T_found
    R, t = error[:, :3, :3], error[:, :3, 3]
    return np.column_stack([np.linalg.norm(t, axis=-1), rotations.angle(R), t, rotations.to_rpy(R)])


def _true_transforms(dataset: Dataset, truth: Truth) -> dict[Edge, Array]:
    """Return those of the dataset's edges that the truth has: constant, or one for each collection."""
    true = {edge: T for edge, T in truth.transforms.items() if edge in dataset.transforms}
    for edge in dataset.transforms:
        poses = [truth.patterns.get(key, {}).get(edge) for key in dataset.keys]
        if any(T is not None for T in poses):
            true[edge] = np.stack([np.full((4, 4), np.nan) if T is None else T for T in poses])
    return true
