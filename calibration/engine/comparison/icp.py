"""ICP: relative pose of two LiDARs or depth cameras from the points that both see on the pattern.

As in ATOM's comparison: point to point, started from the transforms in the dataset (so a bad initial guess fails),
with a threshold on the distance of matches, one collection after the other; the result is the average over
collections, or the one with the best fit. A third variant uses all collections at once, which prevents sliding
along a single board.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError, UndeterminedError
from calibration.engine.comparison.sensor_pair import RANGE_SENSORS, pair_of, why_not_pair, with_pair
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.geometry import rotations
from calibration.engine.geometry.nearest import nearest
from calibration.engine.geometry.transforms import apply, transform

MAX_MATCH_DISTANCE_M = 0.1
"""Largest distance of matched points, m."""
MINIMUM_POINTS = 10
"""Minimum of points of a view."""
MOST_POINTS = 1000
"""Maximum of points of a view; of more, an evenly spaced subset is used."""
MAX_ITERATIONS = 100
MAX_SETTLED_CHANGE = 1e-3
"""Convergence limit on the change of the fraction of matched points and on the relative change of their error."""

Clouds = tuple[Array, Array]
"""Points on the pattern of the first sensor (N, 3) and of the second (M, 3), each in its own frame."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of ICP."""

    T_first_second: Array
    rms: float
    """Root mean square distance of the matched points, m; infinite without matches."""


def icp(dataset: Dataset) -> Dataset:
    """Calibrate the second sensor by ICP on all collections at once and return the new dataset.

    Raises:
        InputError: the method does not apply (`why_not_icp`).
        UndeterminedError: no points match at the initial guess.
    """
    views, start = _views_and_start(dataset)
    return _dataset_with_median(dataset, [align(views, start)], average=False)


def icp_average(dataset: Dataset) -> Dataset:
    """Calibrate by the mean of the poses that ICP finds in each collection; errors as `icp`."""
    views, start = _views_and_start(dataset)
    return _dataset_with_median(dataset, [align([view], start) for view in views], average=True)


def icp_best(dataset: Dataset) -> Dataset:
    """Calibrate by the pose of the collection in which ICP fits best; errors as `icp`."""
    views, start = _views_and_start(dataset)
    return _dataset_with_median(dataset, [align([view], start) for view in views], average=False)


def why_not_icp(dataset: Dataset) -> str | None:
    """Return the reason why the method does not apply to a dataset, in one line; None if it does."""
    reason = why_not_pair(dataset, RANGE_SENSORS, "LiDARs or depth cameras")
    if reason is None and not _cloud_pairs(dataset):
        return f"it needs a view of {MINIMUM_POINTS} points by both sensors, and there is none"
    return reason


def align(views: list[Clouds], start: Array) -> Alignment:
    """Return the pose that aligns the second sensor's points with the first's.

    Args:
        views: with the same relative pose.
        start: ``T_first_second`` (4, 4).
    """
    T, before = start, (-1.0, np.inf)
    total = sum(len(second) for _, second in views)
    for _ in range(MAX_ITERATIONS):
        to, come = _match_points(views, T)
        if not len(to):
            return Alignment(T, np.inf)
        T = _rigid_transform(to, come)
        now = len(to) / total, float(np.sqrt(((apply(T, come) - to) ** 2).sum(-1).mean()))
        if abs(now[0] - before[0]) < MAX_SETTLED_CHANGE and abs(now[1] - before[1]) <= MAX_SETTLED_CHANGE * before[1]:
            break
        before = now
    return Alignment(T, now[1])


def _match_points(views: list[Clouds], T: Array) -> tuple[Array, Array]:
    """Return pairs of nearest points: the first's, and the second's in its own frame, (K, 3) each."""
    to, come = [], []
    for first, second in views:
        moved = apply(T, second)
        partner = first[nearest(moved, first)]
        near = np.linalg.norm(partner - moved, axis=-1) < MAX_MATCH_DISTANCE_M
        to.append(partner[near])
        come.append(second[near])
    return np.concatenate(to), np.concatenate(come)


def _rigid_transform(to: Array, come: Array) -> Array:
    """Return the transform that maps points to others, by least squares (K. Arun et al., 1987)."""
    centre, origin = to.mean(0), come.mean(0)
    R = rotations.nearest((to - centre).T @ (come - origin))
    return transform(R, centre - R @ origin)


def _views_and_start(dataset: Dataset) -> tuple[list[Clouds], Array]:
    reason = why_not_icp(dataset)
    if reason:
        raise InputError(f"{dataset.path}: ICP does not apply: {reason}")
    first, second = pair_of(dataset, RANGE_SENSORS)
    return _cloud_pairs(dataset), dataset.transform(first.frame, second.frame)[0]


def _cloud_pairs(dataset: Dataset) -> list[Clouds]:
    names = [sensor.name for sensor in pair_of(dataset, RANGE_SENSORS)]
    views = []
    for collection in dataset.collections:
        for pattern in dataset.patterns:
            first, second = (collection.labels.get((pattern, name)) for name in names)
            if (
                isinstance(first, PointLabels)
                and isinstance(second, PointLabels)
                and min(len(first.points), len(second.points)) >= MINIMUM_POINTS
            ):
                views.append((_thin_points(first.points), _thin_points(second.points)))
    return views


def _thin_points(points: Array) -> Array:
    count = min(len(points), MOST_POINTS)
    thinned: Array = points[np.arange(count) * len(points) // count]
    return thinned


def _dataset_with_median(dataset: Dataset, alignments: list[Alignment], *, average: bool) -> Dataset:
    good = [alignment for alignment in alignments if np.isfinite(alignment.rms)]
    if not good:
        raise UndeterminedError(
            f"{dataset.path}: ICP finds no points within {MAX_MATCH_DISTANCE_M} m of each other; "
            "it starts from the dataset's transforms, which lie too far off"
        )
    if average:
        T = np.stack([alignment.T_first_second for alignment in good]).mean(0)
        return with_pair(dataset, RANGE_SENSORS, transform(rotations.nearest(T[:3, :3]), T[:3, 3]))
    return with_pair(dataset, RANGE_SENSORS, min(good, key=lambda alignment: alignment.rms).T_first_second)
