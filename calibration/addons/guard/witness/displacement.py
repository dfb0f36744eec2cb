"""The test of an accepted mount against a free one, by what the images say of each pose, and the moment it moved.

The known poses err by a noise of their own, one standard deviation for translations and one for rotations, which the
recording tells by restricted maximum likelihood (Patterson and Thompson, 1971), by EM (Dempster, Laird and Rubin,
1977). The covariance is the sandwich of clusters (Liang and Zeger, 1986), a cluster a scene point. A step is looked for
by the generalised likelihood ratio over all moments (Page, 1957; Andrews, 1993), Bonferroni for their number.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from calibration.addons.guard.outcome import MAX_FALSE_ALARM, t_squared_limit
from calibration.addons.guard.witness.bundle import LENS_COLUMNS
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import adjoint, inverse
from calibration.engine.statistics import t_squared_tail

EM_STEPS, EM_STRIDE = 10, 1.8
"""Steps of EM, and by how much farther than EM each goes; from above: what has not converged is stated too large."""
FIRST_NOISE = (2e-3, 2e-3)
"""m and rad: where EM begins."""
TAIL_FREEDOM = 10.0
"""Of Student's distribution of the poses' errors."""
SLIP = 0.3
"""m and rad: standard deviation of what a wheel may slip, once."""
ANYWHERE = 1.0
"""m and rad: standard deviation of a displacement in directions that nothing tells."""
MIN_SIDE = 4
"""Moments on each side of a step."""
LAG_SIGMA = 0.05
"""s: standard deviation of the time from the images to the motion's records, as far as nobody has measured it."""


class PoseEvidence(Protocol):
    """What images or scans say of the poses (6 K,) and of what the sensor errs in (LENS_COLUMNS,)."""

    @property
    def S(self) -> Array:
        """(n, n): see `b`."""

    @property
    def b(self) -> Array:
        """(n,): ``S x + noise`` with ``noise ~ (0, S)`` for the true unknowns x."""

    def scores(self, x: Array, B: Array) -> Array:
        """Return ``B^T noise`` (C, p) of each cluster, if x (n,) are the true unknowns; B is (n, p)."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """By what a mount has moved, as the images say."""

    twist: Array
    """(6,): m and rad in the camera's accepted frame."""
    covariance: Array
    """(6, 6)."""
    begin: int
    """The first moment at which it has moved; 0 for all along."""
    p: float
    """Probability of so large a difference if nothing has moved, all moments counted."""
    limit: float
    """What T^2 exceeds if it has moved."""
    pose_noise: tuple[float, float]
    """m and rad: by what most poses err, as the images say."""
    may_slip: bool = False
    """Whether one that begins late may be taken for a wheel that slips."""


def displacement_of(
    evidence: PoseEvidence,
    velocities: Array,
    known: tuple[float, float],
    lens_sigmas: Array,
    accepted: Array,
    drift: Array | None = None,
) -> Displacement:
    """Return the displacement of a mount that explains the images best.

    Args:
        evidence: of the images.
        velocities: (K, 6) twist of the camera at each moment, m/s and rad/s, in its frame.
        known: m and rad, least standard deviations of the known poses.
        lens_sigmas: see `evidence_of`.
        accepted: (6, 6) covariance of the accepted mount, as a twist in its frame.
        drift: (n, 6 (K - 1)) by which an error between two moments displaces all later poses, as odometry's does; None
            if every pose errs by itself. How much it is the recording tells.
    """
    K = len(velocities)
    lag = np.concatenate([LAG_SIGMA * velocities.ravel(), np.zeros(LENS_COLUMNS)])
    constant = _columns([0], K)
    fixed = np.outer(lag, lag) + constant @ accepted @ constant.T
    fixed[6 * K :, 6 * K :] += np.diag(lens_sigmas**2)
    begins = [0, *range(MIN_SIDE, K - MIN_SIDE + 1)]
    known_noise = np.repeat(known, 3)
    white, drifted = _noise_covariance(evidence, fixed, known_noise, [0], np.inf, drift)
    begin = _best_begin(evidence, fixed + drifted + white, begins)
    steps = [0, begin] if begin else [0]
    white, drifted = _noise_covariance(evidence, fixed, known_noise, steps, TAIL_FREEDOM, drift)
    fixed = fixed + drifted
    begin = _best_begin(evidence, fixed + white, begins)
    slips = np.zeros((1, len(fixed), 6)) if drift is None else SLIP * drift.reshape(len(fixed), -1, 6).swapaxes(0, 1)

    def fitted(begin: int) -> Displacement:
        """Return what is significant even if a wheel has slipped at any one moment."""
        found = [_fitted(evidence, fixed + slip @ slip.T, white, begin, len(begins)) for slip in slips]
        return replace(max(found, key=lambda each: each.p), may_slip=drift is not None)

    found = fitted(begin)
    return fitted(0) if begin and found.p > MAX_FALSE_ALARM else found  # what could be seen is stated for all along


def drift_of_poses(poses: Array) -> Array:
    """Return how errors between poses (K, 4, 4) add up: twists (6 (K - 1),) of the later of each two."""
    K = len(poses)
    blocks = np.zeros((K, 6, K - 1, 6))
    for i in range(1, K):
        blocks[i:, :, i - 1] = adjoint(inverse(poses[i:]) @ poses[i])
    return np.concatenate([blocks.reshape(6 * K, -1), np.zeros((LENS_COLUMNS, 6 * (K - 1)))])


def _fitted(evidence: PoseEvidence, fixed: Array, white: Array, begin: int, tests: int) -> Displacement:
    K, Q = (len(evidence.b) - LENS_COLUMNS) // 6, fixed + white
    Phi = _columns([begin], K)
    G = np.linalg.inv(np.eye(len(Q)) + evidence.S @ Q)
    B = G.T @ Phi
    SB = evidence.S @ B
    information = Phi.T @ SB + np.eye(6) / ANYWHERE**2
    accuracy = np.linalg.inv(information)
    twist = accuracy @ (B.T @ evidence.b)
    a = Q @ (G @ (evidence.b - evidence.S @ (Phi @ twist)))
    scores = evidence.scores(Phi @ twist + a, B)
    clusters = len(scores)
    noise = _at_least(B.T @ SB, scores.T @ scores * (clusters / max(clusters - 6, 1)))
    meat = noise + SB.T @ Q @ SB
    covariance = accuracy @ (meat + np.eye(6) / ANYWHERE**2) @ accuracy
    squared = float(twist @ np.linalg.solve(covariance, twist))
    freedom = min(clusters, 6 * K, *((6 * begin, 6 * (K - begin)) if begin else ())) - 6
    share = 0.5 if begin == 0 else 0.5 / (tests - 1)
    p = min(1.0, t_squared_tail(squared, 6, freedom) / share)
    limit = t_squared_limit(6, freedom, share * MAX_FALSE_ALARM)
    m, rad = np.sqrt(np.median(np.diag(white)[: 6 * K].reshape(K, 2, 3), axis=(0, 2))).tolist()
    return Displacement(twist, covariance, begin, p, limit, (m, rad))


def _at_least(model: Array, found: Array) -> Array:
    """Return a covariance (6, 6) that is in no direction less than the model's: few clusters may say too little."""
    values, V = np.linalg.eigh(model)
    root = V * np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    to_unit = np.linalg.inv(root)
    ratios, W = np.linalg.eigh(to_unit @ found @ to_unit.T)
    return np.asarray(root @ (W * np.maximum(ratios, 1.0)) @ W.T @ root.T)


def _columns(begins: list[int], K: int) -> Array:
    """Return the columns (6 K + lens, 6 each) of displacements that begin at some moments."""
    steps = [np.concatenate([np.tile(np.eye(6) * (i >= begin), 1) for i in range(K)]) for begin in begins]
    return np.concatenate([np.concatenate(steps, 1), np.zeros((LENS_COLUMNS, 6 * len(begins)))])


def _noise_covariance(
    evidence: PoseEvidence,
    fixed: Array,
    known: Array,
    begins: list[int],
    tail_freedom: float,
    drift: Array | None,
) -> tuple[Array, Array]:
    """Return the covariances (n, n) of the own errors of the known poses, and of their drift, by REML.

    The former are of Student's distribution (Lange, Little and Taylor, 1989): the pose of an image that shows more of
    what moves than of the scene may be far off.
    """
    K = (len(evidence.b) - LENS_COLUMNS) // 6
    Phi, level, weights = _columns(begins, K), np.repeat(FIRST_NOISE, 3), np.ones(K)
    drift_level = level
    white, drifted = np.zeros_like(fixed), np.zeros_like(fixed)
    at = np.arange(6 * K)
    for _ in range(EM_STEPS):
        white[at, at] = (level**2 / weights[:, None]).ravel()
        if drift is not None:
            drift_variances = np.tile(drift_level**2, K - 1)
            drifted = (drift * drift_variances) @ drift.T
        M = np.linalg.solve(np.eye(len(fixed)) + evidence.S @ (white + drifted + fixed), np.c_[evidence.S, evidence.b])
        M, Gb = M[:, :-1], M[:, -1]
        MPhi = M @ Phi
        inverse_information = np.linalg.inv(Phi.T @ MPhi + np.eye(Phi.shape[1]) / ANYWHERE**2)
        pulls = np.asarray(Gb - MPhi @ (inverse_information @ (Phi.T @ Gb)), float)
        used = M - MPhi @ inverse_information @ MPhi.T
        squares = _expected_squares(np.diag(white)[at], pulls[at], np.diag(used)[at])
        if np.isfinite(tail_freedom):
            weights = (tail_freedom + 6) / (tail_freedom + (squares / level**2).sum(1))
        level = np.maximum(_next_level(level, weights[:, None] * squares), known)
        if drift is not None:
            along = np.asarray(((used.T @ drift) * drift).sum(0), float)
            squares = _expected_squares(drift_variances, np.asarray(drift.T @ pulls, float), along)
            drift_level = _next_level(drift_level, squares)
    return white, drifted


def _expected_squares(variances: Array, pulls: Array, used: Array) -> Array:
    """Return the expected squares (K, 6) of errors with such variances, by the data: the E of EM."""
    return np.asarray(((variances * pulls) ** 2 + variances - variances**2 * used).reshape(-1, 6))


def _next_level(level: Array, squares: Array) -> Array:
    """Return the standard deviations (6,) by squares (K, 6), farther than EM goes."""
    found = np.sqrt(squares.reshape(-1, 2, 3).mean((0, 2))).repeat(3)
    return np.asarray(level * (found / level) ** EM_STRIDE)


def _best_begin(evidence: PoseEvidence, Q: Array, begins: list[int]) -> int:
    """Return the moment from which on a displacement explains most."""
    K = (len(evidence.b) - LENS_COLUMNS) // 6
    M = np.linalg.solve(np.eye(len(Q)) + evidence.S @ Q, np.c_[evidence.S, evidence.b])
    blocks, b = M[: 6 * K, : 6 * K].reshape(K, 6, K, 6), M[: 6 * K, -1].reshape(K, 6)
    later = blocks[::-1].cumsum(0)[::-1][:, :, ::-1].cumsum(2)[:, :, ::-1]
    sums = b[::-1].cumsum(0)[::-1]
    best, found = -1.0, 0
    for begin in begins:
        A = later[begin, :, begin] + np.eye(6) / ANYWHERE**2
        gain = float(sums[begin] @ np.linalg.solve(A, sums[begin]))
        if gain > best:
            best, found = gain, begin
    return found
