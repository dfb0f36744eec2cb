"""Views with two readings: patterns in their mirrored pose, and boards that look the same turned by 180 degrees.

A camera sees a mirrored pose nearly as well as the right one, so an optimum may have it. Views of a board without
markers may be numbered from the other end than most.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern
from calibration.engine.estimation.least_squares.minimisation import settle
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.planar_pose import mirrored_poses
from calibration.engine.estimation.residuals.views import ViewGroup
from calibration.engine.estimation.start.single_views import corner_term
from calibration.engine.geometry.transforms import inverse
from calibration.engine.statistics import median

MIN_SUSPICIOUS_COST_RATIO = 1.5
"""Collections whose cost per residual exceeds this multiple of the median are tried with the pattern flipped."""
MAX_AMBIGUOUS_RESIDUAL = 4.0
"""So are collections whose labels, for every camera, would have residuals below this on average (squared, in
standard deviations) if the pattern were mirrored for that camera: few and distant ones."""
MIN_DECREASE = 0.1
"""Minimum decrease of its collection's cost by a flipped pose (and 1 %): less is rounding error."""


def unflipped(problem: Problem, values: Values, weighting: Weighting, cost: Array) -> tuple[Values, BoolArray]:
    """Correct moving patterns, or bases, that are in the mirrored pose, with the shared blocks fixed.

    A planar pattern has nearly the same image in two poses; a solver that starts near the wrong one
    stays there, and distorts the other collections. So collections that fit badly, or in which both poses
    are possible, are solved again from the mirrored pose of their pattern in each camera, by the block that
    moves in its chain.

    Args:
        problem: the problem.
        values: an optimum.
        weighting: its weights.
        cost: (N,), the cost of each collection there.

    Returns:
        The values with the better poses, and a mask (N,) of the collections that had been flipped.
    """
    expected = np.zeros(problem.collections)
    for group in problem.groups:
        for term in group.terms:
            expected[group.collections] += term.counts * term.dimension
    ratio = cost / np.maximum(expected, 1)
    suspicious = ratio > MIN_SUSPICIOUS_COST_RATIO * median(ratio[expected > 0])
    suspicious |= _ambiguous_collections(problem, values, weighting)
    flipped = np.zeros(problem.collections, bool)
    which = np.flatnonzero(suspicious)
    starts = _mirrored_in_each_camera(problem, values, suspicious) if problem.local and len(which) else []
    if not starts:
        return values, flipped
    enough = 0.99 * cost[which] - MIN_DECREASE
    settled, settled_cost = _best_settled(problem, starts, which, weighting, enough)
    better = settled_cost < enough
    flipped[which[better]] = True
    out = list(values)
    for i in problem.local:
        out[i] = out[i].copy()
        out[i][flipped] = settled[i][better]
    return tuple(out), flipped


def _best_settled(
    problem: Problem, starts: list[Values], which: IntArray, weighting: Weighting, below: Array
) -> tuple[Values, Array]:
    """Minimise over the local blocks of some collections (n,) from several starts, all in one problem.

    Args:
        problem: the problem.
        starts: values of all blocks in all collections.
        which: the collections, (n,).
        weighting: what residuals weigh.
        below: (n,), costs at which the minima become of interest.

    Returns:
        The values in these collections alone, for each from the start with the lowest minimum, and that cost (n,).
    """
    several = np.tile(which, len(starts))
    start = tuple(
        np.concatenate([values[i][which] for values in starts]) if block.per_collection else starts[0][i]
        for i, block in enumerate(problem.blocks)
    )
    everywhere, limits = np.ones(len(several), bool), np.tile(below, len(starts))
    settled, cost = settle(problem.repeating(several), start, weighting, everywhere, below=limits)
    costs = np.where(np.isnan(cost), np.inf, cost).reshape(len(starts), -1)
    best = costs.argmin(0) * len(which) + np.arange(len(which))
    found = (T[best] if block.per_collection else T for T, block in zip(settled, problem.blocks, strict=True))
    return tuple(found), costs.min(0)


def _mirrored_in_each_camera(problem: Problem, values: Values, which: BoolArray) -> list[Values]:
    """Return the values with the pattern mirrored for each of the cameras that see it in some collections (N,)."""
    groups = (group for group in problem.seen_in(which).groups if isinstance(group.terms[0], CornerTerm))
    return [mirrored for group in groups if (mirrored := _mirror_pattern(problem, group, values)) is not None]


def _ambiguous_collections(problem: Problem, values: Values, weighting: Weighting) -> BoolArray:
    """Return a mask (N,) of collections where every camera sees nearly the same if the pattern is mirrored for it."""
    possible, seen = np.ones(problem.collections, bool), np.zeros(problem.collections, bool)
    for group in problem.groups:
        if isinstance(group.terms[0], CornerTerm) and _only_moving_link(problem, group) is not None:
            seen[group.collections] = True
            left = possible[group.collections]
            views = group if left.all() else group.take(np.flatnonzero(left))
            if len(views.collections):
                possible[views.collections] = _nearly_same(problem, views, values, weighting)
    return possible & seen


def _nearly_same(problem: Problem, group: ViewGroup, values: Values, weighting: Weighting) -> BoolArray:
    """Return a mask (V,) of a group's views that would look nearly the same if the pattern were mirrored."""
    term = problem.terms(group, values)[0]
    magnitudes = term.magnitudes(mirrored_poses(problem.poses(group, values)))
    squares = np.nan_to_num(magnitudes / weighting.scales[term.kind], copy=False) ** 2
    return np.asarray(squares.sum(-1) < MAX_AMBIGUOUS_RESIDUAL * term.counts * term.dimension)


def _only_moving_link(problem: Problem, group: ViewGroup) -> int | None:
    """Return the position in a group's chain of the only link that moves; None if none or several do."""
    moving = [k for k, link in enumerate(group.chain.links) if link.block in problem.local]
    return moving[0] if len(moving) == 1 else None


def _mirror_pattern(problem: Problem, group: ViewGroup, values: Values) -> Values | None:
    """Set the moving block in a group's chain such that the pattern is mirrored in each of its views."""
    if (k := _only_moving_link(problem, group)) is None:
        return None
    links = group.chain.links
    mirrored = mirrored_poses(problem.poses(group, values))
    parts = (group.chain.part(-1, k), group.chain.part(k, len(links)))
    before, after = (part.poses(problem.transforms(values), group.collections) for part in parts)
    moved = inverse(before) @ mirrored @ inverse(after)
    poses = values[links[k].block].copy()
    poses[group.collections] = inverse(moved) if links[k].inverted else moved
    return tuple(poses if i == links[k].block else value for i, value in enumerate(values))


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
