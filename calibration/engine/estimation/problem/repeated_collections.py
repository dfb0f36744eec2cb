"""Detection of repeated collections: the same poses of robot and pattern, within the noise of the labels."""

from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.geometry.transforms import apply, distance

MAX_SIGMAS_IF_STILL = 2.0
"""Distance, in standard deviations of the labels, within which a pattern has not moved,"""
NEAR_PIXELS, NEAR_METRES = 0.3, 0.005
"""and distance in a camera's view (px), and for other sensors (m)."""
MAX_MOTION_IF_STILL = 1e-3
"""m, rad: tolerance of a transform of a robot that has not moved."""


def repeated_collections(dataset: Dataset, pixel: float | None) -> IntArray:
    """Return the cluster (N,) of each collection: the index of the first one that it repeats, or its own.

    A collection repeats an earlier one if every sensor that saw a pattern in both has it at the same pose, and the
    transforms between the sensors and fixed patterns are the same. Its labels have new noise but hardly any new
    information, so a cluster counts as one independent collection.

    Args:
        dataset: calibrated, so that patterns have their poses.
        pixel: the standard deviation of the corners, px; None without any.
    """
    clusters = np.arange(len(dataset.collections))
    near = _near_pairs(_border_corners(dataset, MAX_SIGMAS_IF_STILL * (pixel or 0.0)))
    moving = _moving_transforms(dataset) if near else []
    for k, first in near:
        if (
            clusters[k] == k
            and clusters[first] == first
            and all(np.max(distance(T[first], T[k])) < MAX_MOTION_IF_STILL for T in moving)
        ):
            clusters[k] = first
    return clusters


def _near_pairs(views: Sequence[Array]) -> list[tuple[int, int]]:
    """Pairs (i, j), j < i, ascending, of rows that are near in each of the views (N, F) which has both, and in one."""
    N = len(views[0]) if views else 0
    numbers = [np.zeros(0, int)]
    for view in views:
        i, j = _candidate_pairs(view)
        near = ~_rows_differ(view, i, j)
        numbers.append(i[near] * N + j[near])
    together = np.concatenate(numbers)
    if not len(together):
        return []
    i, j = np.divmod(np.unique(together), N)
    near = np.ones(len(i), bool)
    for view in views:
        near &= ~_rows_differ(view, i, j)
    return list(zip(i[near].tolist(), j[near].tolist(), strict=True))


def _rows_differ(view: Array, i: IntArray, j: IntArray) -> BoolArray:
    """Whether rows of a view (N, F) differ; NaN, not seen in both, is ignored."""
    apart: BoolArray = ((view[i] - view[j]) ** 2).mean(-1) > 1.0
    return apart


def _candidate_pairs(view: Array) -> tuple[IntArray, IntArray]:
    """Pairs of rows i, j, j < i, of a view (N, F) whose first two coordinates allow that they are near."""
    order = view[:, 0].argsort(kind="stable")[: np.isfinite(view[:, 0]).sum()]
    ranked = view[order, 0]
    counts = np.searchsorted(ranked, ranked + np.sqrt(view.shape[-1]), side="right") - np.arange(len(order)) - 1
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    a, b = order[first], order[second]
    close = np.abs(view[a, 1] - view[b, 1]) <= np.sqrt(view.shape[-1])
    a, b = a[close], b[close]
    return np.maximum(a, b), np.minimum(a, b)


def _border_corners(dataset: Dataset, pixels: float) -> list[Array]:
    """Return the border's corners of each pattern in each sensor (N, 8 or 12), in tolerances; NaN if unseen."""
    found = []
    for name, pattern in dataset.patterns.items():
        corners = np.column_stack([pattern.outline, np.zeros(len(pattern.outline))])
        for sensor in dataset.sensors.values():
            at = _collections_seen(dataset, name, sensor.name)
            if not len(at):
                continue
            points = apply(dataset.transform(sensor.frame, pattern.link, at), corners)
            if sensor.camera and sensor.modality.has_corners:
                z = np.maximum(points[..., 2:], 1e-3)  # the border may be behind the camera
                focal = np.array([sensor.camera.fx, sensor.camera.fy])
                near = focal * points[..., :2] / z / max(pixels, NEAR_PIXELS)
            else:
                near = points / NEAR_METRES
            view = np.full((len(dataset.collections), near[0].size), np.nan)
            view[at] = near.reshape(len(at), -1)
            found.append(view)
    return found


def _collections_seen(dataset: Dataset, pattern: str, sensor: str) -> IntArray:
    """Return the collections (V,) in which a sensor saw a pattern that has a pose there."""
    board = dataset.patterns[pattern]
    seen = np.array([i for i, c in enumerate(dataset.collections) if (pattern, sensor) in c.labels], int)
    pose = dataset.transforms.get((board.parent_link, board.link))
    return seen if pose is None else seen[np.isfinite(pose[seen, 0, 0])]


def _moving_transforms(dataset: Dataset) -> list[Array]:
    """Return the transforms (N, 4, 4) between sensors and fixed patterns that differ between collections."""
    edges = {
        (step.parent, step.child)
        for pattern in dataset.patterns.values()
        if pattern.fixed
        for sensor in dataset.sensors.values()
        for step in dataset.tree.path(sensor.frame, pattern.parent_link)
    }
    T = [dataset.transforms[edge] for edge in sorted(edges - dataset.moving_transforms)]
    return [each for each in T if np.ptp(each, axis=0).max() > MAX_MOTION_IF_STILL]
