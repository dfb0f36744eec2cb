"""Errors of chains of frames against the true ones, in ATOM's form.

ATOM's evaluations ``ground_truth_transform`` and ``ground_truth_frame``. ATOM reports the mean of the signed
coordinates as translation error (0 for 10 mm along x and -10 along y) and the mean of three Euler
angles as rotation error; here these columns are the norm and the angle. Unobservable parts of the error
(gauge freedom) are not removed: for that see `truth_error`.
"""

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.truth import Truth
from calibration.engine.evaluation.selection import sensor_of
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse

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
