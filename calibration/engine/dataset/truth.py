"""Ground truth of a dataset: the values that a calibration should find."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, read_json
from calibration.engine.dataset.edges import read_transform
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointParameter

FILE_NAME = "ground_truth.json"


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
    path = dataset.path.parent / FILE_NAME
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
