"""Views by themselves: the pose of the pattern from each camera view, and the poses or points that labels determine.

Poses are ``T_camera_centre``: the pattern's frame moved to the centre of its corners, as in
`calibration.engine.estimation.problem.problem`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.least_squares.minimisation import TERMINATION_OF_SETTLING, Termination, settle
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Block, Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.planar_pose import mirrored_poses
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Chain, Link, ViewGroup
from calibration.engine.geometry.cameras import Camera
from calibration.engine.statistics import median

TERMINATION_AT_PRECISION = Termination(decrease=1e-12, iterations=100)
"""To machine precision: written results must not depend on where a solver stops."""
MEDIAN_OF_TWO = np.sqrt(2 * np.log(2))
"""Median length of a residual of two coordinates, in standard deviations of one (Rayleigh's distribution)."""
POOR_FIT = 1.5
"""RMS (px) of a view after its linear pose, above which it may have outliers."""


def corner_term(camera: Camera, pattern: Pattern, views: Sequence[CornerLabels]) -> CornerTerm:
    """Return the term of a camera's views of a pattern."""
    V, K = len(views), len(pattern.corners)
    corners = pattern.corners - pattern.centre
    pixels, seen = np.zeros((V, 2, K)), np.zeros((V, K), bool)
    if views:
        labelled = np.concatenate([labels.pixels for labels in views])
        ids = np.concatenate([labels.ids for labels in views])
        if len(ids) == V * K and (ids.reshape(V, K) == np.arange(K)).all():  # the usual case, at a third of the cost
            return CornerTerm(camera, corners, np.ascontiguousarray(labelled.reshape(V, K, 2).swapaxes(1, 2)), None)
        of = np.repeat(np.arange(V), [len(labels.ids) for labels in views])
        pixels[of, :, ids] = labelled
        seen[of, ids] = True
    return CornerTerm(camera, corners, pixels, None if seen.all() else seen)


def refined_poses(
    term: CornerTerm, T: Array, huber: float | None = None, until: Termination = TERMINATION_AT_PRECISION
) -> tuple[Array, Array]:
    """Refine the pose of each view by least squares in pixels, which never makes a view worse.

    Args:
        term: the labels.
        T: (V, 4, 4), initial guesses; NaN stays NaN.
        huber: threshold in pixels of the robust loss; None for plain least squares.
        until: termination criteria.

    Returns:
        The poses (V, 4, 4), and the root mean square error (V,) of each view in pixels, of the robust
        loss where there is one; NaN for a pattern behind the camera.
    """
    return _refine_together([term], T, huber, until)


def _refine_together(
    terms: Sequence[CornerTerm], T: Array, huber: float | None, until: Termination
) -> tuple[Array, Array]:
    """`refined_poses` of the views of several cameras together, one after the other."""
    chain = Chain(None, (Link(0, inverted=False),))
    counts = np.concatenate([term.counts for term in terms])
    ends = np.cumsum([len(term.counts) for term in terms])
    views = np.split(np.arange(len(T)), ends[:-1])
    groups = [ViewGroup("camera", "pattern", at, chain, (term,)) for at, term in zip(views, terms, strict=True)]
    problem = Problem((Block("view", per_collection=True),), tuple(groups), len(T))
    given: BoolArray = np.isfinite(T[:, 0, 0])
    start = np.where(given[:, None, None], T, np.eye(4))
    with np.errstate(invalid="ignore", over="ignore"):
        (found,), cost = settle(problem, (start,), Weighting({"pixel": 1.0}, huber), given, until)
        usable = given & np.isfinite(cost)
        rms = np.sqrt(cost / np.maximum(counts, 1))
    return np.where(usable[:, None, None], found, np.nan), np.where(usable, rms, np.nan)


def fitted_poses(term: CornerTerm) -> tuple[Array, Array]:
    """Return the best pose of each view: least squares from the linear pose and from its mirror image.

    Returns as `refined_poses`, for each view the better of two minima.
    """
    T, rms = refined_poses(term, term.linear_poses)
    mirrored, mirrored_rms = refined_poses(term, mirrored_poses(T))
    flipped = mirrored_rms < rms
    return np.where(flipped[:, None, None], mirrored, T), np.where(flipped, mirrored_rms, rms)


def robust_poses(terms: Sequence[CornerTerm]) -> list[Array]:
    """Estimate ``T_camera_centre`` (V, 4, 4) of each view by itself; NaN if its corners do not determine it.

    Views that the linear solution fits badly, because of outliers or few corners, are refined with
    a robust loss.

    Args:
        terms: of each camera and pattern.
    """
    poses = [term.linear_poses.copy() for term in terms]
    bad = [_fitted_badly(term, T) for term, T in zip(terms, poses, strict=True)]
    if some := [i for i, views in enumerate(bad) if len(views)]:
        start = np.concatenate([poses[i][bad[i]] for i in some])
        refined, _ = _refine_together(
            [terms[i].take(bad[i]) for i in some], start, huber=2.0, until=TERMINATION_OF_SETTLING
        )
        for i, T in zip(some, np.split(refined, np.cumsum([len(bad[i]) for i in some])[:-1]), strict=True):
            poses[i][bad[i]] = T
    return poses


def _fitted_badly(term: CornerTerm, T: Array) -> IntArray:
    """Return the views with far larger residuals at some poses (V, 4, 4) than the others, or NaN ones."""
    given = np.isfinite(T[:, 0, 0])
    with np.errstate(invalid="ignore"):
        squares = term.magnitudes(T) ** 2
        there = ~np.isnan(squares)
        rms = np.sqrt(np.where(there, squares, 0.0).sum(-1) / np.count_nonzero(there, axis=-1))
        return np.flatnonzero(given & ~(rms <= min(2 * median(rms[given]), POOR_FIT)))


def noise_inside_views(problem: Problem, values: Values) -> dict[str, float]:
    """Return the noise of the corners that each camera's views tell of themselves, whatever contradicts them.

    Args:
        problem: the problem.
        values: of its blocks; the intrinsics are theirs.

    Returns:
        By camera, the standard deviation of each image coordinate, px, from the median residual of all its corners.
    """
    found: dict[str, float] = {}
    for group in problem.groups:
        term, *_ = problem.terms(group, values)
        if isinstance(term, CornerTerm):
            T, _ = refined_poses(term, term.linear_poses, huber=1.0, until=TERMINATION_OF_SETTLING)
            residuals = term.magnitudes(T)
            noise = median(residuals[np.isfinite(residuals)]) / MEDIAN_OF_TWO
            found[group.sensor] = max(noise, found.get(group.sensor, 0.0))
    return found


@dataclass(frozen=True, eq=False)
class Sight:
    """V views ``T_sensor_pattern = chain``: of a group, or combined from two groups of the same moving pattern."""

    sensor: str
    pattern: str
    chain: Chain
    collections: IntArray
    """(V,)."""
    counts: IntArray
    """(V,): numbers of labels."""
    seen: Array | None
    """``T_sensor_pattern`` (V, 4, 4) of a camera, or measured; NaN if a view determines none."""
    points: RangeTerm | None
    """Points on the pattern's plane, of a LiDAR or a depth camera."""

    def through(self, other: "Sight", seen: Array) -> "Sight":
        """Combine with another sensor's views (V, 4, 4) of the same pattern in common collections; its pose cancels."""
        _, own, at = np.intersect1d(self.collections, other.collections, return_indices=True)
        to_pattern, from_pattern = (sight.chain.part(-1, len(sight.chain.links) - 1) for sight in (self, other))
        return replace(
            self,
            chain=to_pattern.take(own).then(from_pattern.take(at).inverse()).then(Chain(seen[at], ())),
            collections=self.collections[own],
            counts=self.counts[own],
            seen=None if self.seen is None else self.seen[own],
            points=None if self.points is None else self.points.take(own),
        )


def sights_of(groups: Sequence[ViewGroup]) -> tuple[Sight, ...]:
    """Return the views of each group, with the poses or points that their labels alone determine."""
    terms = [group.terms[0] for group in groups]
    corners = {i: term for i, term in enumerate(terms) if isinstance(term, CornerTerm)}
    seen = dict(zip(corners, robust_poses([*corners.values()]), strict=True))
    found = []
    for i, (group, term) in enumerate(zip(groups, terms, strict=True)):
        pose = term.measured if isinstance(term, PoseTerm) else seen.get(i)
        points = term if isinstance(term, RangeTerm) else None
        found.append(Sight(group.sensor, group.pattern, group.chain, group.collections, term.counts, pose, points))
    return tuple(found)
