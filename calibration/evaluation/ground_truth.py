"""Chains of frames against the true ones, in ATOM's form.

ATOM's evaluations ``ground_truth_transform`` and ``ground_truth_frame``. Where it has the mean of the signed
coordinates as the error of a translation (0 for 10 mm along x and -10 along y) and the mean of three Euler
angles as that of a rotation, these columns hold the norm and the angle. A part of the error that no
calibration can know is not removed: for that see `truth_error`.
"""

import numpy as np

from calibration.dataset.model import Dataset, Edge
from calibration.dataset.truth import Truth
from calibration.errors import InputError
from calibration.evaluation.selection import sensor_of
from calibration.evaluation.table import COLLECTION, Table
from calibration.geometry import rotations
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array

COLUMNS = ("Trans (m)", "Rot (rad)", "X (m)", "Y (m)", "Z (m)", "Roll (rad)", "Pitch (rad)", "Yaw (rad)")
TRANSFORMATION = "Transformation #"


def ground_truth_transform(dataset: Dataset, truth: Truth | None, parent: str, child: str) -> Table:
    """The error of the pose of one frame in another in each collection, seen from the true child.

    Columns: the norm (m) and the angle (rad) of the error; its coordinates, and roll, pitch, yaw about fixed axes.

    Args:
        dataset: with the transforms to evaluate.
        truth: the true ones.
        parent: a frame.
        child: another, with a transform on the way that the truth has.

    Raises:
        InputError: there is no truth, or none on the way between the frames; a frame is unknown or not connected.
    """
    return Table(COLLECTION, COLUMNS, dataset.keys, _errors(dataset, truth, parent, child))


def ground_truth_frame(dataset: Dataset, truth: Truth | None, frame: str, sensor: str | None = None) -> Table:
    """The errors of what is calibrated, seen from a frame.

    With a sensor it is `ground_truth_transform` from the frame to that sensor's calibrated child. Without one
    there is a row for each sensor and additional transform: the means of the absolute values over the collections.

    Raises:
        InputError: as `ground_truth_transform`, or there is no such sensor.
    """
    if sensor is not None:
        return ground_truth_transform(dataset, truth, frame, sensor_of(dataset, sensor).calibration_child)
    children = {name: s.calibration_child for name, s in dataset.sensors.items() if name != dataset.anchored}
    children |= {"-".join(edge): edge[1] for edge in dataset.additional_transforms}
    rows = {name: _errors(dataset, truth, frame, child) for name, child in children.items()}
    if not rows:
        raise InputError(f"{dataset.path}: nothing is calibrated")
    values = np.stack([np.abs(errors).mean(0) for errors in rows.values()])
    return Table(TRANSFORMATION, COLUMNS, tuple(rows), values)


def _errors(dataset: Dataset, truth: Truth | None, parent: str, child: str) -> Array:
    """The columns (N, 8)."""
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
    """Of the dataset's edges those that the truth has: the same in all collections, or one for each."""
    true = {edge: T for edge, T in truth.transforms.items() if edge in dataset.transforms}
    for edge in dataset.transforms:
        poses = [truth.patterns.get(key, {}).get(edge) for key in dataset.keys]
        if any(T is not None for T in poses):
            true[edge] = np.stack([np.full((4, 4), np.nan) if T is None else T for T in poses])
    return true
