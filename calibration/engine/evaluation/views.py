"""Views of a pattern by a camera, over all collections, and the pose estimated from each view alone."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, PoseLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses
from calibration.engine.evaluation.selection import camera_of
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse, translation


@dataclass(frozen=True, eq=False)
class CornerViews:
    """V views of a pattern with K corners by a camera. Unseen corners are zero."""

    collections: IntArray
    """(V,): index of each view's collection, ascending."""
    pixels: Array
    """(V, 2, K): the labels."""
    rays: Array
    """(V, 3, K): their rays, of any length."""
    seen: BoolArray
    """(V, K)."""
    T_camera_pattern: Array
    """(V, 4, 4): least squares on each view alone."""
    left_out: tuple[str, ...]
    """Views from which no pose can be estimated."""

    def __getitem__(self, views: IntArray) -> "CornerViews":
        """Return a subset of the views, in this order."""
        return CornerViews(
            self.collections[views],
            self.pixels[views],
            self.rays[views],
            self.seen[views],
            self.T_camera_pattern[views],
            self.left_out,
        )


@dataclass(frozen=True, eq=False)
class MeasuredViews:
    """V measured poses of a pattern."""

    collections: IntArray
    """(V,): index of each pose's collection, ascending."""
    T_camera_pattern: Array
    """(V, 4, 4)."""


def measured_views(dataset: Dataset, sensor: str, pattern: Pattern) -> MeasuredViews:
    """Return the labels of a sensor that are poses."""
    found = [(i, label.T) for i, label in dataset.detections(pattern.name, sensor) if isinstance(label, PoseLabels)]
    poses = np.array([T for _, T in found]).reshape(-1, 4, 4)
    return MeasuredViews(np.array([i for i, _ in found], int), poses)


def corner_views(dataset: Dataset, sensor: str, pattern: Pattern) -> CornerViews:
    """Return the views of a camera from which the pose of the pattern can be estimated.

    They do not depend on the dataset's transforms, so the results for the last few datasets are cached.

    Raises:
        InputError: there is no such camera.
    """
    _, camera = camera_of(dataset, sensor)
    return _corner_views(dataset.collections, sensor, camera, pattern)


@lru_cache(maxsize=8)
def _corner_views(collections: tuple[Collection, ...], sensor: str, camera: Camera, pattern: Pattern) -> CornerViews:
    """Cache of `corner_views`, keyed by immutable collections and patterns, which compare by identity."""
    labels = ((i, collection.labels.get((pattern.name, sensor))) for i, collection in enumerate(collections))
    detections = [(i, label) for i, label in labels if isinstance(label, CornerLabels)]
    term = corner_term(camera, pattern, [label for _, label in detections])
    seen = np.ones((len(detections), len(pattern.corners)), bool) if term.seen is None else term.seen
    rays = np.where(seen[:, None], np.swapaxes(camera.distortion.chart.rays(*np.swapaxes(term.rays, 0, 1)), 0, 1), 0.0)
    T_camera_centre, _ = fitted_poses(term)
    T = T_camera_centre @ inverse(translation(pattern.centre))
    good = np.isfinite(T[:, 0, 0])
    left_out = tuple(
        f"{collections[i].key}: the {len(label.ids)} corners that {sensor} sees do not give a pose"
        for (i, label), usable in zip(detections, good, strict=True)
        if not usable
    )
    arrays = np.array([i for i, _ in detections], int)[good], term.pixels[good], rays[good], seen[good], T[good]
    for array in arrays:
        array.flags.writeable = False
    return CornerViews(*arrays, left_out)
