"""Errors of labels against the poses of patterns in a dataset or a result, as tables, and of each label for figures.

ATOM's evaluation ``single_rgb`` tests the sensors together with the poses of the patterns, which the
calibration fits to the same labels: for a moving pattern it measures only the overall fit.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels, PoseLabels, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.evaluation.views import camera_of, measured_views, pattern_of, tracker_of
from calibration.engine.geometry.transforms import apply, distance, inverse

SINGLE_RGB_HEADER = "Collection"
ALL_HEADER = "all [px]"


def single_rgb(dataset: Dataset, camera: str | None = None, pattern: str | None = None) -> Table:
    """Return the mean distance between projected and labelled corners in each collection (px).

    There is a column for every camera and pattern, and one with the mean of the row's values;
    the value is missing where a camera does not see a pattern, or the dataset has no pose of it.

    Args:
        dataset: the transforms to evaluate, including the patterns'.
        camera: the only camera to evaluate; None for all.
        pattern: the only pattern to evaluate; None for all.

    Raises:
        InputError: no such camera or pattern, a transform is missing, or no camera sees a pattern that has a pose.
    """
    patterns = list(dataset.patterns.values()) if pattern is None else [pattern_of(dataset, pattern)]
    names = [s.name for s in dataset.sensors.values() if s.modality.has_corners] if camera is None else [camera]
    pairs = [(name, each) for each in patterns for name in names]
    values = np.full((len(dataset.keys), len(pairs)), np.nan)
    seen = np.zeros(values.shape, bool)
    for column, (name, each) in enumerate(pairs):
        for i, error in _mean_distances(dataset, name, each).items():
            values[i, column], seen[i, column] = error, True
    rows = np.flatnonzero(seen.any(1))
    if not len(rows):
        raise InputError(f"{dataset.path}: no camera sees a pattern whose pose the dataset has")
    values, seen = values[rows], seen[rows]
    mean = np.where(seen, values, 0.0).sum(1) / seen.sum(1)
    return Table(
        SINGLE_RGB_HEADER,
        (*(f"{name}-{each.name} [px]" for name, each in pairs), ALL_HEADER),
        tuple(dataset.keys[i] for i in rows),
        np.column_stack([values, mean]),
        tuple(f"{key}: no camera sees a pattern" for i, key in enumerate(dataset.keys) if i not in rows),
        missing=np.column_stack([~seen, np.zeros(len(rows), bool)]),
    )


def _mean_distances(dataset: Dataset, name: str, pattern: Pattern) -> dict[int, float]:
    """Return the mean distance by the index of the collection; infinite if a corner is behind the camera."""
    sensor, camera = camera_of(dataset, name)
    placed = dataset.transforms.get(pattern.edge)
    views = {
        i: label
        for i, label in dataset.detections(pattern.name, name)
        if isinstance(label, CornerLabels) and placed is not None and np.isfinite(placed[i, 0, 0])
    }
    if not views:
        return {}
    errors = {}
    T_camera_pattern = dataset.seen_by(name).with_collections(list(views)).transform(sensor.frame, pattern.link)
    for (i, label), T in zip(views.items(), T_camera_pattern, strict=True):
        distance = np.linalg.norm(camera.project(apply(T, pattern.corners[label.ids])) - label.pixels, axis=-1)
        errors[i] = float(distance.mean()) if np.isfinite(distance).all() else np.inf
    return errors


MEASURED_POSE_COLUMNS = ("Translation (mm)", "Rotation (deg)")


def measured_poses(dataset: Dataset, sensor: str, pattern: str | None = None) -> Table:
    """Return the translation and rotation error of each measured pose.

    Args:
        dataset: the transforms to evaluate, including the pattern's.
        sensor: a sensor with poses as labels.
        pattern: its name; None if the dataset has only one.

    Raises:
        InputError: no such sensor or pattern, its labels are no poses, or the dataset has no pose of the pattern.
    """
    found, board = tracker_of(dataset, sensor), pattern_of(dataset, pattern)
    views = measured_views(dataset, sensor, board)
    if not len(views.collections):
        raise InputError(f"{dataset.path}: '{sensor}' measures no pose of '{board.name}'")
    seen = dataset.seen_by(sensor).with_collections(views.collections.tolist())
    off, turned = distance(seen.transform(found.frame, board.link), views.T_camera_pattern)
    return Table(COLLECTION_HEADER, MEASURED_POSE_COLUMNS, seen.keys, np.stack([1e3 * off, np.degrees(turned)], -1))


REPROJECTION_COLUMNS = ("RMS (pix)",)


def reprojection(calibration: Calibration) -> Table:
    """Return the root mean square of the reprojection errors of all cameras in each collection (px).

    Raises:
        InputError: no camera has labels.
    """
    squares: dict[str, list[float]] = {}
    for view in calibration.residuals:
        if view.kind == "pixel":
            for key, errors in zip(view.collections, view.magnitudes, strict=True):
                squares.setdefault(key, []).extend((errors[np.isfinite(errors)] ** 2).tolist())
    if not squares:
        raise InputError(
            f"{calibration.dataset.path}: no camera has labels, so there are no reprojection errors: choose "
            f"another table (evaluate), such as {_other_table(calibration.dataset)}"
        )
    keys = sorted(squares, key=int)
    return Table(
        COLLECTION_HEADER,
        REPROJECTION_COLUMNS,
        tuple(keys),
        np.array([[np.sqrt(np.mean(squares[key]))] for key in keys]),
    )


def _other_table(dataset: Dataset) -> str:
    """Name a table for a dataset without cameras."""
    tracker = next((name for name, sensor in dataset.sensors.items() if sensor.modality.family == "tracker"), None)
    return f"measured-poses:{tracker}" if tracker else "lidar-to-lidar:SOURCE:TARGET"


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a sensor's n labels."""

    collections: IntArray
    """(n,): indices of the collections."""
    where: Array
    """(n, 2): pixels of a camera's labels; (n, 3): points of another sensor, or measured origins of patterns, in its
    frame, m."""
    values: Array
    """(n, 2): reprojection minus label, px; (n, 1): distance from the pattern's plane, m; (n, 3): calibrated minus
    measured origin of the pattern, m."""

    @property
    def sizes(self) -> Array:
        """(n,): norms of the residuals."""
        return np.asarray(np.linalg.norm(self.values, axis=-1))


def residuals(dataset: Dataset, sensor: Sensor) -> Residuals:
    """Return the residuals of a sensor's labels with the transforms of a dataset; views without any are left out."""
    indices: list[IntArray] = [np.zeros(0, np.int64)]
    camera = sensor.camera if sensor.modality.has_corners else None
    places: list[Array] = [np.zeros((0, 2 if camera else 3))]
    values: list[Array] = [np.zeros((0, 2 if camera else 3 if sensor.modality.has_poses else 1))]
    for pattern in dataset.patterns.values():
        views = dict(dataset.detections(pattern.name, sensor.name))
        for i, T in _poses_of_views(dataset, sensor.frame, pattern.link, list(views)):
            labels = views[i]
            if camera is not None and isinstance(labels, CornerLabels):
                places.append(labels.pixels)
                values.append(camera.project(apply(T, pattern.corners[labels.ids])) - labels.pixels)
            elif isinstance(labels, PointLabels):
                places.append(labels.points)
                values.append(apply(inverse(T), labels.points)[:, 2:])
            elif isinstance(labels, PoseLabels):
                places.append(labels.T[None, :3, 3])
                values.append((T[:3, 3] - labels.T[:3, 3])[None])
            indices.append(np.full(len(places[-1]), i))
    found = Residuals(np.concatenate(indices), np.concatenate(places), np.concatenate(values))
    finite = np.isfinite(found.values).all(axis=-1)
    return Residuals(found.collections[finite], found.where[finite], found.values[finite])


def _poses_of_views(dataset: Dataset, sensor: str, pattern: str, views: list[int]) -> Iterator[tuple[int, Array]]:
    """``T_sensor_pattern`` of each view; none where a transform is missing, as in a view that was left out."""
    try:
        yield from zip(views, dataset.with_collections(views).transform(sensor, pattern), strict=True)
    except InputError:
        for i in views if len(views) > 1 else ():
            yield from _poses_of_views(dataset, sensor, pattern, [i])
