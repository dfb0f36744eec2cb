"""Scene points and camera poses by least squares: what images alone say of the errors of poses that are known.

A bundle adjustment (Triggs, McLauchlan, Hartley and Fitzgibbon, 2000) with scene points as an anchor's ray and an
inverse depth (Montiel, Civera and Davison, 2006), so that far ones are well behaved. Every pose is free within limits:
a sensor may have moved at any moment. Points that fit no rigid scene (people, the robot's own links, wrong matches)
lose their weight by graduated non-convexity (Geman and McClure's kernel; Black and Rangarajan, 1996).
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import retract

COMMON_M, COMMON_RAD = 0.02, 0.1
"""m and rad: standard deviation of what all poses have in common, while wrong points are told apart."""
OWN_M, OWN_RAD = 0.005, 0.008
"""m and rad: of each pose by itself; a step may be many of them, as all points of an image ask for it."""
STIFFEST = 16.0
"""By how much less each pose is free by itself at the first kernel: what moves cannot take the poses along."""
WIDEST_PX = 16.0
"""px: scale of the first kernel: a mount that moved by degrees leaves its poses enough to find their place."""
SCALES = 8
"""Kernels from the widest to the last."""
LAST_STEPS = 3
"""Steps of the least squares after points that do not fit were left out."""
MAX_SIGMAS = 3.5
"""Standard deviations up to which an observation fits."""
MIN_FITTING_SHARE = 0.7
"""Of a point's observations: one of which fewer fit is no part of the rigid scene, however well some do."""
MAX_POINT_SIGMAS = 3.0
"""Of the squared residuals of a point: one that moves slowly fits at each moment, but not at all of them."""
MIN_SIGMA_PX = 0.05
"""px: no feature is found better."""
MEDIAN_RAYLEIGH = 1.1774
"""Median length of a residual of two coordinates of standard deviation 1."""
FIRST_DEPTHS = np.array([0.0, 0.1, 0.2, 0.4, 0.7, 1.2, 2.0, 3.5, 6.0])
"""1/m: inverse depths among which the best one of a point is the start."""
MAX_INVERSE_DEPTH = 50.0
"""1/m: no camera sees what is nearer."""
POINTS_AT_ONCE = 400
"""Points that are eliminated in one product of matrices, which bounds the memory."""
LENS_COLUMNS = 3
"""Shared parameters: relative focal length, principal point (normalised)."""
WIDTH = 6 + LENS_COLUMNS


@dataclass(frozen=True, eq=False)
class Observations:
    """What is seen of scene points, in rays of a pinhole of focal length 1."""

    poses: Array
    """(V, 4, 4): ``T_root_camera`` of each image by the accepted mount."""
    slots: IntArray
    """(V,): the unknown of each image, one number a moment; -1 of one that is held."""
    views: IntArray
    """(M,): image of each observation."""
    points: IntArray
    """(M,): scene point of each observation, 0 .. J - 1."""
    at: Array
    """(M, 2): normalised coordinates."""
    clusters: IntArray
    """(J,): points of one cluster may err together."""
    focal_px: float
    """px: focal length, which makes residuals pixels."""
    least: int = 2
    """Observations that each point has at least: with two, what moves along its epipolar line fits at some depth."""

    @property
    def moments(self) -> int:
        """Number of unknown poses."""
        return int(self.slots.max(initial=-1)) + 1

    def kept(self, mask: BoolArray) -> "Observations":
        """Return some observations: of points of which enough remain."""
        seen = np.bincount(self.points[mask], minlength=len(self.clusters))
        mask = mask & (seen >= self.least)[self.points]
        names, points = np.unique(self.points[mask], return_inverse=True)
        return replace(self, views=self.views[mask], points=points, at=self.at[mask], clusters=self.clusters[names])


class Linearised(NamedTuple):
    """Residuals and their derivatives at some poses and points."""

    residuals: Array
    """(M, 2) px."""
    by_unknowns: Array
    """(M, 2, WIDTH): by the twist of the image's pose, and the lens."""
    by_point: Array
    """(M, 2, 3)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What images say of the unknowns (n,): twists of the poses in the camera's frame, moment by moment, and the lens.

    ``b = S x + noise`` with ``noise ~ (0, S)`` for the true unknowns x, all scene points eliminated (Schur).
    """

    observations: Observations
    """Those that fit."""
    S: Array
    """(n, n)."""
    b: Array
    """(n,)."""
    sigma_px: float
    """px: standard deviation of a coordinate."""
    linearised: Linearised
    found: Array
    """(n,): the unknowns at which it is linearised."""

    def scores(self, x: Array, B: Array) -> Array:
        """Return ``B^T noise`` (C, p) of each cluster of points, if x (n,) are the true unknowns; B is (n, p)."""
        o, (r, J, Jp) = self.observations, self.linearised
        columns = unknown_columns(o)
        r = (r - np.einsum("mij,mj->mi", J, (x - self.found)[columns])) / self.sigma_px
        J, Jp = J / self.sigma_px, Jp / self.sigma_px
        V = sums_of_groups(np.einsum("mij,mik->mjk", Jp, Jp), o.points)
        p = np.einsum("jab,jb->ja", _inverses(V), sums_of_groups(np.einsum("mij,mi->mj", Jp, r), o.points))
        r = r - np.einsum("mij,mj->mi", Jp, p[o.points])
        scores = np.einsum("mi,mij,mjp->mp", r, J, B[columns])
        return sums_of_groups(scores, o.clusters[o.points])


def evidence_of(observations: Observations, lens_sigmas: Array) -> Evidence | None:
    """Return what the images say of the poses; None if too few points fit.

    Args:
        observations: of scene points.
        lens_sigmas: (LENS_COLUMNS,) standard deviations of the relative focal length and the principal point, in
            focal lengths.
    """
    o = observations
    n = 6 * o.moments + LENS_COLUMNS
    x, points = np.zeros(n), _first_points(o)
    if _freedom(o) < 1:
        return None
    fitted = np.sqrt(2 * len(o.views) / _freedom(o))  # by so much more the observations err than what remains
    for step in range(SCALES):
        linearised = _linearise(o, x, points)
        length = np.linalg.norm(linearised.residuals, axis=-1)
        sigma = max(float(np.median(length)) / MEDIAN_RAYLEIGH * fitted, MIN_SIGMA_PX)
        scale = max(WIDEST_PX * (3 * sigma / WIDEST_PX) ** (step / (SCALES - 1)), 3 * sigma)
        weights = (1 + (length / scale) ** 2) ** -2
        prior = unknown_prior(o.moments, lens_sigmas, STIFFEST ** (step / (SCALES - 1) - 1))
        x, points = _step(o, x, points, linearised, weights, sigma, prior)
    for _ in range(LAST_STEPS):
        length = np.linalg.norm(_linearise(o, x, points).residuals, axis=-1)
        fits = length <= MAX_SIGMAS * sigma
        seen = np.bincount(o.points)
        rigid = np.bincount(o.points, fits) >= MIN_FITTING_SHARE * seen
        squares, freedom = np.bincount(o.points, np.where(fits, length / sigma, 0.0) ** 2), np.maximum(2 * seen - 3, 1)
        rigid &= squares <= freedom + MAX_POINT_SIGMAS * np.sqrt(2 * freedom)
        fits &= rigid[o.points]
        stay = np.bincount(o.points[fits], minlength=len(points)) >= o.least
        o, points = o.kept(fits), points[stay]
        if _freedom(o) < 1:
            return None
        linearised = _linearise(o, x, points)
        sigma = _sigma(o, linearised)
        x, points = _step(o, x, points, linearised, np.ones(len(o.views)), sigma, prior)
    sigma = _sigma(o, _linearise(o, x, points))
    # All poses at one mount: at the noise of each, directions that nothing tells would seem to differ, and be told
    # (Huang, Mourikis and Roumeliotis, 2010).
    x = np.concatenate([np.tile(x[:-LENS_COLUMNS].reshape(-1, 6).mean(0), o.moments), np.zeros(LENS_COLUMNS)])
    weights = np.full(len(o.views), sigma**-2)
    for _ in range(LAST_STEPS):
        linearised = _linearise(o, x, points)
        S, g, (inverses, bp, _) = _reduced(o, linearised, weights, n)
        points = _moved(points, np.einsum("jab,jb->ja", inverses, bp))
    return Evidence(o, S, S @ x + g, sigma, linearised, x)


def unknown_prior(moments: int, lens_sigmas: Array, softness: float) -> Array:
    """Return the inverse covariance (n, n) of the unknowns."""
    common, own = (np.repeat(each, 3) ** 2 for each in ((COMMON_M, COMMON_RAD), (softness * OWN_M, softness * OWN_RAD)))
    C = np.zeros((6 * moments + LENS_COLUMNS,) * 2)
    C[:-LENS_COLUMNS, :-LENS_COLUMNS] = np.tile(np.diag(common), (moments, moments)) + np.diag(np.tile(own, moments))
    C[-LENS_COLUMNS:, -LENS_COLUMNS:] = np.diag(np.maximum(lens_sigmas, 1e-9) ** 2)
    return np.asarray(np.linalg.inv(C))


def _freedom(o: Observations) -> int:
    """Return the residuals less what is fitted to them."""
    return 2 * len(o.views) - 3 * len(o.clusters) - 6 * o.moments


def _sigma(o: Observations, linearised: Linearised) -> float:
    return max(float(np.sqrt((linearised.residuals**2).sum() / _freedom(o))), MIN_SIGMA_PX)


def unknown_columns(o: Observations) -> IntArray:
    """Return the columns (M, WIDTH) of the unknowns on which each observation depends."""
    slots = np.maximum(o.slots[o.views], 0)
    lens = np.broadcast_to(6 * o.moments + np.arange(LENS_COLUMNS), (len(slots), LENS_COLUMNS))
    return np.concatenate([6 * slots[:, None] + np.arange(6), lens], 1)


def _anchors(o: Observations) -> IntArray:
    """Return the first observation (J,) of each point."""
    return np.asarray(np.unique(o.points, return_index=True)[1])


def _first_points(o: Observations) -> Array:
    """Return the points (J, 3): ray at the anchor, and the inverse depth that fits best."""
    at = o.at[_anchors(o)]
    costs = []
    for depth in FIRST_DEPTHS:
        points = np.concatenate([at, np.full((len(at), 1), depth)], 1)
        length = np.linalg.norm(_linearise(o, np.zeros(6 * o.moments + LENS_COLUMNS), points).residuals, axis=-1)
        costs.append(sums_of_groups(1 - (1 + (length / WIDEST_PX) ** 2) ** -1, o.points))
    return np.concatenate([at, FIRST_DEPTHS[np.argmin(costs, 0)][:, None]], 1)


def _linearise(o: Observations, x: Array, points: Array) -> Linearised:
    anchor = o.poses[o.views[_anchors(o)]]
    twists = np.concatenate([x[: 6 * o.moments].reshape(-1, 6), np.zeros((1, 6))])[o.slots]
    T = retract(o.poses, twists)[o.views]
    R = T[:, :3, :3].transpose(0, 2, 1)
    rays = np.concatenate([points[:, :2], np.ones((len(points), 1))], 1)
    turned = np.einsum("jab,jb->ja", anchor[:, :3, :3], rays)
    shift = anchor[o.points, :3, 3] - T[:, :3, 3]
    depth = points[o.points, 2]
    q = np.einsum("mab,mb->ma", R, turned[o.points] + depth[:, None] * shift)
    z = np.where(q[:, 2] > 1e-3, q[:, 2], 1e-3)
    ratio = q[:, :2] / z[:, None]
    focal, centre = 1 + x[-LENS_COLUMNS], x[-2:]
    slopes = np.zeros((len(z), 2, 3))
    slopes[:, 0, 0] = slopes[:, 1, 1] = 1 / z
    slopes[:, :, 2] = -ratio / z[:, None]
    slopes *= o.focal_px * focal
    by_unknowns = np.zeros((len(z), 2, WIDTH))
    by_unknowns[..., :3] = -depth[:, None, None] * slopes
    by_unknowns[..., 3:6] = slopes @ rotations.hat(q)
    by_unknowns[o.slots[o.views] < 0, :, :6] = 0
    by_unknowns[..., 6] = o.focal_px * ratio
    by_unknowns[:, 0, 7] = by_unknowns[:, 1, 8] = o.focal_px
    by_ray = R @ anchor[o.points, :3, :2]
    by_point = slopes @ np.concatenate([by_ray, np.einsum("mab,mb->ma", R, shift)[..., None]], -1)
    return Linearised(o.focal_px * (o.at - focal * ratio - centre), by_unknowns, by_point)


def _step(
    o: Observations, x: Array, points: Array, linearised: Linearised, weights: Array, sigma: float, prior: Array
) -> tuple[Array, Array]:
    """Return the unknowns and points after a step of Gauss-Newton."""
    S, g, back = _reduced(o, linearised, weights / sigma**2, len(x))
    dx = np.linalg.solve(S + prior, g - prior @ x)
    inverses, bp, Z = back
    dp = np.einsum(
        "jab,jb->ja", inverses, bp - sums_of_groups(np.einsum("mjk,mj->mk", Z, dx[unknown_columns(o)]), o.points)
    )
    return x + dx, _moved(points, dp)


def _moved(points: Array, step: Array) -> Array:
    moved = points + np.clip(step, -1, 1)
    moved[:, 2] = np.clip(moved[:, 2], 0, MAX_INVERSE_DEPTH)
    return np.asarray(moved)


def _reduced(
    o: Observations, linearised: Linearised, weights: Array, n: int
) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Return the normal equations (n, n), (n,) without the points, and what brings these back."""
    r, J, Jp = linearised
    WJ, WJp = weights[:, None, None] * J, weights[:, None, None] * Jp
    inverses = _inverses(sums_of_groups(np.einsum("mij,mik->mjk", WJp, Jp), o.points))
    bp = sums_of_groups(np.einsum("mij,mi->mj", WJp, r), o.points)
    Z = np.einsum("mij,mik->mjk", WJ, Jp)
    roots = np.linalg.cholesky(inverses)
    Y = Z @ roots[o.points]
    columns = unknown_columns(o)
    S, g = np.zeros((n, n)), np.zeros(n)
    np.add.at(
        g,
        columns,
        np.einsum("mij,mi->mj", WJ, r) - np.einsum("mjk,mk->mj", Y, np.einsum("jba,jb->ja", roots, bp)[o.points]),
    )
    np.add.at(S, (columns[:, :, None], columns[:, None, :]), np.einsum("mij,mik->mjk", WJ, J))
    order = np.argsort(o.points, kind="stable")
    bounds = np.searchsorted(o.points[order], np.arange(0, len(inverses) + POINTS_AT_ONCE, POINTS_AT_ONCE))
    for begin, end in pairwise(bounds.tolist()):
        rows = order[begin:end]
        if not len(rows):
            continue
        used, at = np.unique(columns[rows], return_inverse=True)
        first = o.points[rows].min()
        part = np.zeros((len(used), int(o.points[rows].max() - first) + 1, 3))
        np.add.at(part, (at.reshape(len(rows), -1), (o.points[rows] - first)[:, None]), Y[rows])
        flat = part.reshape(len(used), -1)
        S[np.ix_(used, used)] -= flat @ flat.T
    return S, g, (inverses, bp, Z)


def _inverses(V: Array) -> Array:
    """Return inverses (J, 3, 3); an inverse depth that nothing tells is held near where it is."""
    trace = np.einsum("jaa->j", V)
    weak = np.maximum(1e-12 * trace, 1e-12)[:, None, None] * np.eye(3)  # more would tell the scale of two images
    return np.asarray(np.linalg.inv(V + weak))


def sums_of_groups(values: Array | BoolArray, groups: IntArray) -> Array:
    """Return the sums (G, ...) of values (M, ...) of each group."""
    count = int(groups.max(initial=-1)) + 1
    flat = np.asarray(values, float).reshape(len(values), math.prod(values.shape[1:]))
    found = np.stack([np.bincount(groups, column, count) for column in flat.T], -1)
    return np.asarray(found.reshape(count, *values.shape[1:]), float)
