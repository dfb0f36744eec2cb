"""Boards without markers that look the same turned by 180 degrees: views numbered from the other end than most."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern
from calibration.engine.estimation.start.single_views import corner_term

COLLECTIONS_TAKEN_AS_KNOWN = 3
"""Number of collections whose rotation is taken for known when branches are chosen."""
MAX_COLLECTIONS_COMPARED = 60
"""Limit of the number of collections that each is compared with, spread over all of them."""
MAX_ROUNDS = 4
"""Number of rounds in which the branches are chosen again."""


def rotations_that_agree(branches: Array, measured: Array) -> tuple[Array, float]:
    """Choose the branch of each rotation with which all agree best with measured ones.

    If ``A_i = X B_i Y``, then ``trace(A_i A_j^T) = trace(B_i B_j^T)`` for all i and j, whatever X and Y are.

    Args:
        branches: B (N, b, 3, 3); NaN where there are fewer.
        measured: A (N, 3, 3).

    Returns:
        The chosen rotations (N, 3, 3), and the median difference of those traces: of right ones, twice their error
        in rad at most.
    """
    N, b = branches.shape[:2]
    some = np.unique(np.linspace(0, N - 1, min(N, MAX_COLLECTIONS_COMPARED)).round().astype(int))
    there = np.isfinite(branches[..., 0, 0])
    flat = np.nan_to_num(branches).reshape(N, b, 9)
    traces = measured.reshape(N, 9) @ measured[some].reshape(-1, 9).T  # (N, some)
    first = [(i, branch) for i in range(min(COLLECTIONS_TAKEN_AS_KNOWN, len(some))) for branch in range(b)]
    starts = np.array([(i, branch) for i, branch in first if there[some[i], branch]])
    known = flat[some[starts[:, 0]], starts[:, 1]]
    off = np.abs(flat[some] @ known.T - traces[some][:, None, starts[:, 0]])
    chosen = np.where(there[some][..., None], off, np.inf).argmin(1)  # (some, starts)

    def chosen_beside(others: IntArray, start: int) -> IntArray:
        """Return the branch of each of others with which it agrees best with those chosen from a start."""
        now = flat[some, chosen[:, start]]  # (some, 9)
        off = np.abs(flat[others] @ now.T - traces[others][:, None]).mean(-1)
        return np.asarray(np.where(there[others], off, np.inf).argmin(1))

    for _ in range(MAX_ROUNDS if b > 1 else 0):
        chosen = np.stack([chosen_beside(some, start) for start in range(len(starts))], 1)
    now = flat[some[:, None], chosen].swapaxes(0, 1)  # (starts, some, 9)
    pairs = np.triu_indices(len(some), 1)
    apart = np.median(np.abs(now @ now.swapaxes(1, 2) - traces[some])[:, *pairs], -1)
    best = int(apart.argmin())
    return branches[np.arange(N), chosen_beside(np.arange(N), best)], float(apart[best])


def trace_differences(R: Array, measured: Array) -> Array:
    """Return how far the traces of all pairs of rotations are from those of measured ones: (N, N), of (N, 3, 3)."""
    flat, known = R.reshape(-1, 9), measured.reshape(-1, 9)
    return np.asarray(np.abs(flat @ flat.T - known @ known.T))


def disagreement_of_each(R: Array, measured: Array) -> Array:
    """Return the median difference (N,) of each rotation's traces from those of measured ones, both (N, 3, 3)."""
    return np.asarray(np.median(trace_differences(R, measured), -1))


MIN_VIEWS = 4
"""Number of views below which none is turned."""
MAX_MEDIAN_DISAGREEMENT, MAX_DISAGREEMENT = 0.1, 0.25
"""Limits of the differences of two rotations' traces (`agreeing_rotations`), each the median over the other views: of
the median of all views, and of each view that is turned."""
MIN_GAIN = 0.25
"""By how much the difference of the turned views is less than it was, on average: where many are turned, the median of
some is small even so."""
MIN_CORNERS = 6
"""Number of corners below which a view's rotation is not known."""
HALF_A_TURN = np.diag([-1.0, -1.0, 1.0])
LOOKS_THE_SAME = "this board looks the same turned by 180 degrees"
View = tuple[str, str, str]
"""Pattern, sensor and the collection's key."""


@dataclass(frozen=True, eq=False)
class _Views:
    """Rotations of a pattern by a camera's views, each by itself."""

    sensor: str
    pattern: str
    at: IntArray
    """(V,): collections."""
    R: Array
    """``R_sensor_pattern`` (V, 3, 3)."""


def with_boards_turned_back(dataset: Dataset) -> tuple[Dataset, tuple[View, ...]]:
    """Return the dataset with all views of a board numbered from one end, and the views that were from the other.

    On an arm, ``R_sensor_pattern = X B Y`` in all collections, with the robot's rotation B; two cameras that see a
    moving pattern have one rotation to each other. Where either end would do, as on an arm, the views are turned that
    are fewer. Nothing changes unless half a turn makes them agree.
    """
    turned = tuple(_from_the_other_end(dataset))
    for pattern, sensor, _ in dict.fromkeys((p, s, "") for p, s, _ in turned):
        keys = {key for p, s, key in turned if (p, s) == (pattern, sensor)}
        dataset = with_turned(dataset, pattern, sensor, keys)
    return dataset, turned


def _from_the_other_end(dataset: Dataset) -> Iterator[View]:
    for pattern in dataset.patterns.values():
        if pattern.kind not in UNMARKED_KINDS:
            continue
        views = [each for sensor in dataset.sensors if (each := _views_of_board(dataset, pattern, sensor)) is not None]
        if pattern.fixed:
            for each in views:
                yield from _turned_views(dataset, each, each.at, _by_the_robot(dataset, each, pattern), each.R)
        elif len(views) > 1:
            first, *others = sorted(views, key=lambda each: -len(each.at))
            for each in others:
                _, own, at = np.intersect1d(each.at, first.at, return_indices=True)
                same = np.broadcast_to(np.eye(3), (len(own), 3, 3))
                yield from _turned_views(dataset, each, each.at[own], same, each.R[own], np.swapaxes(first.R[at], 1, 2))


def _views_of_board(dataset: Dataset, pattern: Pattern, sensor: str) -> _Views | None:
    camera = dataset.sensors[sensor].camera
    labels = [
        (i, label)
        for i, label in dataset.detections(pattern.name, sensor)
        if isinstance(label, CornerLabels) and len(label.ids) >= MIN_CORNERS
    ]
    if camera is None or len(labels) < MIN_VIEWS:
        return None
    with np.errstate(all="ignore"):
        R = corner_term(camera, pattern, [label for _, label in labels]).linear_poses[:, :3, :3]
    usable = np.isfinite(R).all((1, 2))
    return _Views(sensor, pattern.name, np.array([i for i, _ in labels])[usable], R[usable])


def _by_the_robot(dataset: Dataset, views: _Views, pattern: Pattern) -> Array:
    """Return the rotations (V, 3, 3) of the pattern's parent in the sensor, as the dataset has them."""
    try:
        return dataset.transform(dataset.sensors[views.sensor].frame, pattern.parent_link, views.at)[:, :3, :3]
    except InputError:  # a transform is missing: there is nothing to compare with
        return np.full((len(views.at), 3, 3), np.nan)


def _turned_views(
    dataset: Dataset, views: _Views, at: IntArray, known: Array, R: Array, after: Array | None = None
) -> Iterator[View]:
    """Yield the views that half a turn makes agree: R (V, 3, 3), perhaps followed by others, with known rotations."""
    if len(R) < MIN_VIEWS or not np.isfinite(known).all():
        return
    branches = np.stack([R, R @ HALF_A_TURN], 1) @ (np.eye(3) if after is None else after[:, None])
    chosen, _ = rotations_that_agree(branches, known)
    is_turned = np.abs(chosen - branches[:, 1]).max((1, 2)) < np.abs(chosen - branches[:, 0]).max((1, 2))
    for some in sorted((is_turned, ~is_turned), key=np.count_nonzero):
        if _agree_only_turned(branches, known, some):
            yield from ((views.pattern, views.sensor, dataset.keys[at[i]]) for i in np.flatnonzero(some).tolist())
            return


def _agree_only_turned(branches: Array, known: Array, is_turned: BoolArray) -> bool:
    """Whether views agree with known rotations, but only with some of them turned."""
    every = np.arange(len(known))
    off = disagreement_of_each(branches[every, is_turned.astype(int)], known)
    gain = disagreement_of_each(branches[:, 0], known) - off
    return bool(
        is_turned.any()
        and np.median(off) < MAX_MEDIAN_DISAGREEMENT
        and off[is_turned].max() < MAX_DISAGREEMENT
        and gain[is_turned].mean() > MIN_GAIN
    )


def turned(pattern_corners: int, label: CornerLabels) -> CornerLabels:
    """Return the labels of a board with its corners numbered from its other end: turned by 180 degrees."""
    return CornerLabels((pattern_corners - 1 - label.ids)[::-1].copy(), label.pixels[::-1].copy())


def with_turned(dataset: Dataset, pattern: str, sensor: str, only: set[str] | None = None) -> Dataset:
    """Return the dataset with a board numbered from its other end in a sensor's views, of some collections only."""
    count = len(dataset.patterns[pattern].corners)
    key = (pattern, sensor)
    collections = []
    for c in dataset.collections:
        label = c.labels.get(key)
        if isinstance(label, CornerLabels) and (only is None or c.key in only):
            collections.append(replace(c, labels={**c.labels, key: turned(count, label)}))
        else:
            collections.append(c)
    return replace(dataset, collections=tuple(collections))
