"""The test of an accepted mount against a free one, by what the images say of each pose, and the moment it moved.

The known poses err by a noise of their own, one standard deviation for translations and one for rotations, which the
recording tells by restricted maximum likelihood (Patterson and Thompson, 1971), by EM (Dempster, Laird and Rubin,
1977). The covariance is the sandwich of clusters (Liang and Zeger, 1986), a cluster a scene point. A step is looked for
by the generalised likelihood ratio over all moments (Page, 1957; Andrews, 1993), Bonferroni for their number.
"""

from dataclasses import dataclass

import numpy as np

from calibration.addons.guard.outcome import MAX_FALSE_ALARM, t_squared_limit
from calibration.addons.guard.witness.bundle import LENS_COLUMNS, Evidence
from calibration.base.arrays import Array
from calibration.engine.baseline.comparison import t_squared_tail

EM_STEPS, EM_STRIDE = 10, 1.8
"""Steps of EM, and by how much farther than EM each goes; from above: what has not converged is stated too large."""
FIRST_NOISE = (2e-3, 2e-3)
"""m and rad: where EM begins."""
TAIL_FREEDOM = 10.0
"""Of Student's distribution of the poses' errors."""
ANYWHERE = 1.0
"""m and rad: standard deviation of a displacement in directions that nothing tells."""
MIN_SIDE = 4
"""Moments on each side of a step."""
LAG_SIGMA = 0.05
"""s: standard deviation of the time from the images to the motion's records, as far as nobody has measured it."""


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


def displacement_of(
    evidence: Evidence, velocities: Array, known: tuple[float, float], lens_sigmas: Array, accepted: Array
) -> Displacement:
    """Return the displacement of a mount that explains the images best.

    Args:
        evidence: of the images.
        velocities: (K, 6) twist of the camera at each moment, m/s and rad/s, in its frame.
        known: m and rad, least standard deviations of the known poses.
        lens_sigmas: see `evidence_of`.
        accepted: (6, 6) covariance of the accepted mount, as a twist in its frame.
    """
    K = len(velocities)
    lag = np.concatenate([LAG_SIGMA * velocities.ravel(), np.zeros(LENS_COLUMNS)])
    constant = _columns([0], K)
    fixed = np.outer(lag, lag) + constant @ accepted @ constant.T
    fixed[6 * K :, 6 * K :] += np.diag(lens_sigmas**2)
    begins = [0, *range(MIN_SIDE, K - MIN_SIDE + 1)]
    known_noise = np.repeat(known, 3)
    white = _noise_covariance(evidence, fixed, known_noise, [0], np.inf)
    begin = _best_begin(evidence, fixed + white, begins)
    white = _noise_covariance(evidence, fixed, known_noise, [0, begin] if begin else [0], TAIL_FREEDOM)
    begin = _best_begin(evidence, fixed + white, begins)
    found = _fitted(evidence, fixed, white, begin, len(begins))
    if begin and found.p > MAX_FALSE_ALARM:  # what could be seen is stated for a mount that is off all along
        return _fitted(evidence, fixed, white, 0, len(begins))
    return found


def _fitted(evidence: Evidence, fixed: Array, white: Array, begin: int, tests: int) -> Displacement:
    K, Q = (len(evidence.b) - LENS_COLUMNS) // 6, fixed + white
    Phi = _columns([begin], K)
    G = np.linalg.inv(np.eye(len(Q)) + evidence.S @ Q)
    B = G.T @ Phi
    SB = evidence.S @ B
    information = Phi.T @ SB + np.eye(6) / ANYWHERE**2
    inverse = np.linalg.inv(information)
    twist = inverse @ (B.T @ evidence.b)
    a = Q @ (G @ (evidence.b - evidence.S @ (Phi @ twist)))
    scores = evidence.scores(Phi @ twist + a, B)
    clusters = len(scores)
    noise = _at_least(B.T @ SB, scores.T @ scores * (clusters / max(clusters - 6, 1)))
    meat = noise + SB.T @ Q @ SB
    covariance = inverse @ (meat + np.eye(6) / ANYWHERE**2) @ inverse
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
    inverse = np.linalg.inv(root)
    ratios, W = np.linalg.eigh(inverse @ found @ inverse.T)
    return np.asarray(root @ (W * np.maximum(ratios, 1.0)) @ W.T @ root.T)


def _columns(begins: list[int], K: int) -> Array:
    """Return the columns (6 K + lens, 6 each) of displacements that begin at some moments."""
    steps = [np.concatenate([np.tile(np.eye(6) * (i >= begin), 1) for i in range(K)]) for begin in begins]
    return np.concatenate([np.concatenate(steps, 1), np.zeros((LENS_COLUMNS, 6 * len(begins)))])


def _noise_covariance(evidence: Evidence, fixed: Array, known: Array, begins: list[int], tail_freedom: float) -> Array:
    """Return the covariance (n, n) of the errors of the known poses, by REML.

    They are of Student's distribution (Lange, Little and Taylor, 1989): the pose of an image that shows more of what
    moves than of the scene may be far off.
    """
    K = (len(evidence.b) - LENS_COLUMNS) // 6
    Phi, level, weights = _columns(begins, K), np.repeat(FIRST_NOISE, 3), np.ones(K)
    white = np.zeros_like(fixed)
    at = np.arange(6 * K)
    for _ in range(EM_STEPS):
        white[at, at] = (level**2 / weights[:, None]).ravel()
        M = np.linalg.solve(np.eye(len(fixed)) + evidence.S @ (white + fixed), np.c_[evidence.S, evidence.b])
        M, Gb = M[:, :-1], M[:, -1]
        MPhi = M @ Phi
        inverse = np.linalg.inv(Phi.T @ MPhi + np.eye(Phi.shape[1]) / ANYWHERE**2)
        variances = np.diag(white)
        means = variances * (Gb - MPhi @ (inverse @ (Phi.T @ Gb)))
        used = np.diag(M) - np.einsum("ij,jk,ik->i", MPhi, inverse, MPhi)
        squares = (means**2 + variances - variances**2 * used)[: 6 * K].reshape(K, 6)
        if np.isfinite(tail_freedom):
            weights = (tail_freedom + 6) / (tail_freedom + (squares / level**2).sum(1))
        found = np.sqrt((weights[:, None] * squares).reshape(K, 2, 3).mean((0, 2))).repeat(3)
        level = np.maximum(level * (found / level) ** EM_STRIDE, known)
    return white


def _best_begin(evidence: Evidence, Q: Array, begins: list[int]) -> int:
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
