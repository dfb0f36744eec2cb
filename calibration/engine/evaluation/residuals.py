"""Residuals of a calibrated dataset for each label, for figures; tables contain only averages."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.base.errors import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels, PoseLabels, Sensor
from calibration.engine.geometry.transforms import apply, inverse


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
        sizes: Array = np.linalg.norm(self.values, axis=-1)
        return sizes


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
