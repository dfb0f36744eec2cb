"""Patterns that an optimum has in their mirrored pose, which a camera sees nearly as well as the right one."""

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.estimation.least_squares.minimisation import settle
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.planar_pose import mirrored_poses
from calibration.engine.estimation.residuals.statistics import median
from calibration.engine.estimation.residuals.views import ViewGroup
from calibration.engine.geometry.transforms import inverse

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
