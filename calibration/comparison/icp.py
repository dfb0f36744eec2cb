"""ICP: the relative pose of two LiDARs or depth cameras, from the points that both see on the pattern.

As ATOM's comparison has it: point to point, from the transforms in the dataset (so a far start goes wrong),
points farther apart than a threshold left out, one collection after the other; then the average of the
results, or the one that fits best. A third row takes all collections at once, which leaves no sliding
along a single board.
"""

from dataclasses import dataclass

import numpy as np

from calibration.comparison.sensor_pair import RANGE_SENSORS, pair_of, why_not_pair, with_pair
from calibration.dataset.model import Dataset, PointLabels
from calibration.errors import InputError, UndeterminedError
from calibration.geometry import rotations
from calibration.geometry.nearest import nearest
from calibration.geometry.transforms import apply, transform
from calibration.geometry.types import Array

THRESHOLD = 0.1
"""m: two points farther apart are not the same place."""
MINIMUM_POINTS = 10
"""Of a view."""
MOST_POINTS = 1000
"""Of a view; of more, so many are taken, evenly."""
ITERATIONS = 100
SETTLED = 1e-3
"""It stops when the share of matched points and their error change by less; the error relative to itself."""

Clouds = tuple[Array, Array]
"""What the first sensor (N, 3) and the second (M, 3) see on the pattern, each in its own frame."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where ICP stops."""

    T_first_second: Array
    rms: float
    """m: of the points that have a match; infinite where none has."""


def icp(dataset: Dataset) -> Dataset:
    """The dataset with the second sensor's transform by ICP on all collections at once.

    Raises:
        InputError: the method does not apply (`why_not_icp`).
        UndeterminedError: no points lie near each other at the start.
    """
    views, start = _views_and_start(dataset)
    return _placed(dataset, [align(views, start)], average=False)


def icp_average(dataset: Dataset) -> Dataset:
    """The dataset with the mean of the poses that ICP finds in each collection; errors as `icp`."""
    views, start = _views_and_start(dataset)
    return _placed(dataset, [align([view], start) for view in views], average=True)


def icp_best(dataset: Dataset) -> Dataset:
    """The dataset with the pose of the collection in which ICP fits best; errors as `icp`."""
    views, start = _views_and_start(dataset)
    return _placed(dataset, [align([view], start) for view in views], average=False)


def why_not_icp(dataset: Dataset) -> str | None:
    """One line that says why the method does not apply to a dataset; None if it does."""
    reason = why_not_pair(dataset, RANGE_SENSORS, "LiDARs or depth cameras")
    if reason is None and not _views(dataset):
        return f"it needs a view of {MINIMUM_POINTS} points by both sensors, and there is none"
    return reason


def align(views: list[Clouds], start: Array) -> Alignment:
    """The pose that lays the second sensor's points on the first's.

    Args:
        views: seen from the same relative pose.
        start: ``T_first_second`` (4, 4).
    """
    T, before = start, (-1.0, np.inf)
    total = sum(len(second) for _, second in views)
    for _ in range(ITERATIONS):
        to, come = _matches(views, T)
        if not len(to):
            return Alignment(T, np.inf)
        T = _rigid(to, come)
        now = len(to) / total, float(np.sqrt(((apply(T, come) - to) ** 2).sum(-1).mean()))
        if abs(now[0] - before[0]) < SETTLED and abs(now[1] - before[1]) <= SETTLED * before[1]:
            break
        before = now
    return Alignment(T, now[1])


def _matches(views: list[Clouds], T: Array) -> tuple[Array, Array]:
    """The pairs of points nearest to each other: the first's, and the second's in its own frame, (K, 3) each."""
    to, come = [], []
    for first, second in views:
        moved = apply(T, second)
        partner = first[nearest(moved, first)]
        near = np.linalg.norm(partner - moved, axis=-1) < THRESHOLD
        to.append(partner[near])
        come.append(second[near])
    return np.concatenate(to), np.concatenate(come)


def _rigid(to: Array, come: Array) -> Array:
    """The transform that moves points nearest to others, least squares (K. Arun et al., 1987)."""
    centre, origin = to.mean(0), come.mean(0)
    R = rotations.nearest((to - centre).T @ (come - origin))
    return transform(R, centre - R @ origin)


def _views_and_start(dataset: Dataset) -> tuple[list[Clouds], Array]:
    reason = why_not_icp(dataset)
    if reason:
        raise InputError(f"{dataset.path}: ICP does not apply: {reason}")
    first, second = pair_of(dataset, RANGE_SENSORS)
    return _views(dataset), dataset.transform(first.frame, second.frame)[0]


def _views(dataset: Dataset) -> list[Clouds]:
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
                views.append((_thinned(first.points), _thinned(second.points)))
    return views


def _thinned(points: Array) -> Array:
    count = min(len(points), MOST_POINTS)
    thinned: Array = points[np.arange(count) * len(points) // count]
    return thinned


def _placed(dataset: Dataset, alignments: list[Alignment], *, average: bool) -> Dataset:
    good = [alignment for alignment in alignments if np.isfinite(alignment.rms)]
    if not good:
        raise UndeterminedError(
            f"{dataset.path}: ICP finds no points within {THRESHOLD} m of each other; "
            "it starts from the dataset's transforms, which lie too far off"
        )
    if average:
        T = np.stack([alignment.T_first_second for alignment in good]).mean(0)
        return with_pair(dataset, RANGE_SENSORS, transform(rotations.nearest(T[:3, :3]), T[:3, 3]))
    return with_pair(dataset, RANGE_SENSORS, min(good, key=lambda alignment: alignment.rms).T_first_second)
