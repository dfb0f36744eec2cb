"""Fit of cameras to the patterns' poses in the dataset: corners projected directly.

ATOM's evaluation ``single_rgb``. It tests the sensors together with the poses of the patterns, which the
calibration fits to the same labels: for a moving pattern it measures only the overall fit.
"""

import numpy as np

from calibration.base.errors import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.evaluation.selection import camera_of, pattern_of
from calibration.engine.evaluation.table import Table
from calibration.engine.geometry.transforms import apply

COLLECTION_HEADER = "Collection"
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
        COLLECTION_HEADER,
        (*(f"{name}-{each.name} [px]" for name, each in pairs), ALL_HEADER),
        tuple(dataset.keys[i] for i in rows),
        np.column_stack([values, mean]),
        tuple(f"{key}: no camera sees a pattern" for i, key in enumerate(dataset.keys) if i not in rows),
        missing=np.column_stack([~seen, np.zeros(len(rows), bool)]),
    )


def _mean_distances(dataset: Dataset, name: str, pattern: Pattern) -> dict[int, float]:
    """Return the mean distance by the index of the collection; infinite if a corner is behind the camera."""
    sensor, camera = camera_of(dataset, name)
    placed = dataset.transforms.get((pattern.parent_link, pattern.link))
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
