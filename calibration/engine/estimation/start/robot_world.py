"""Robot-world and hand-eye problem, solved by linear algebra: ``A_i = X @ B_i @ Y`` for X and Y.

With an arm that carries a pattern in front of a camera, ``A_i = T_camera_pattern`` is measured,
``B_i = T_base_flange`` is known from the joints, ``X = T_camera_base`` and ``Y = T_flange_pattern``
are unknown. The literature writes ``A Z' = X B`` with ``Z' = inverse(Y)``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.base.arrays import Array, ArrayLike
from calibration.engine.estimation.residuals.statistics import median
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform

MAX_REWEIGHTINGS = 10
"""Number of times that a robot-world problem is solved again with less weight on views that do not fit,"""
MAX_MISFIT_IF_FITTING = 0.03
"""as long as their mean misfit exceeds this (rad, and translations relative to the distance)."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Observability of a robot-world problem, from the motion and the measurements."""

    dispersion: Array
    """(3,): by how much the rotations of B tilt a fixed direction (rad), for the least tilted direction first.
    All 0: no rotation. One 0: rotations about one axis only. None 0: the motion determines X and Y."""
    axis: Array
    """(3,): the least tilted direction, a unit vector in B's child frame: the rotation axis, if there is only one."""

    def axes(self, threshold: float = 1e-3) -> int:
        """Approximate number of rotation axes: 0, 1 or (enough) 2; a tilt below `threshold` rad counts as none."""
        return max(0, int((self.dispersion > threshold).sum()) - 1)


class RobotWorld(NamedTuple):
    """Solution of ``A_i = X @ B_i @ Y``."""

    X: Array
    """(4, 4)."""
    Y: Array
    """(4, 4)."""
    spectrum: Spectrum


def solve_robot_world(A: Array, B: Array, weights: ArrayLike | None = None) -> RobotWorld:
    """Solve for X and Y by the Kronecker product: rotations first, then translations.

    ``R_X`` and ``R_Y^T`` are the nearest rotations to the leading pair of singular vectors of the sum
    of ``R_A kron R_B``; the translations follow from one linear least squares in the frame of A's
    parent (M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker
    product", 2013).

    A motion that does not determine them still gives finite numbers: check `Spectrum`. At least three
    poses with rotations about two axes are needed.

    Args:
        A: (n, 4, 4), finite.
        B: (n, 4, 4), finite.
        weights: (n,), not negative; None for equal weights.

    Raises:
        ValueError: there is no pose.
    """
    w = _normalised_weights(A, weights)
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    # R_A = R_X R_B R_Y: maximise sum w <R_A R_Y^T, R_X R_B> = vec(R_X)^T K vec(R_Y^T)
    K = np.einsum("n,nij,nkl->ikjl", w, RA, RB).reshape(9, 9)
    U, _, Vt = np.linalg.svd(K)
    X, Yt = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(X)) or 1.0  # both singular vectors may be negated together
    R_X, R_Yt = rotations.nearest(sign * X), rotations.nearest(sign * Yt)
    # t_A = R_X t_B + t_X + R_A R_Y^T t_Y
    t_X, t_Y = _solve_translations(A, B, w, R_X, RA @ R_Yt)
    return RobotWorld(transform(R_X, t_X), transform(R_Yt.T, t_Y), _spectrum_of_rotations(RB, w))


def solve_robot_world_robustly(A: Array, B: Array) -> RobotWorld:
    """Solve like `solve_robot_world`, reweighted a few times so that single wrong or flipped views have no effect."""
    solution = first = solve_robot_world(A, B)
    size = median(np.linalg.norm(A[:, :3, 3], axis=-1))
    for _ in range(MAX_REWEIGHTINGS):
        translation, rotation = distance(A, solution.X @ B @ solution.Y)
        miss = translation / size + rotation
        if miss.mean() <= MAX_MISFIT_IF_FITTING:
            break
        solution = solve_robot_world(A, B, 1 / np.maximum(miss, 0.5 * median(miss) + 1e-9) ** 2)
    return solution._replace(spectrum=first.spectrum)


def solve_li(A: Array, B: Array, weights: ArrayLike | None = None) -> RobotWorld:
    """Solve for X and Y by one linear system for rotations and translations together.

    The 24 unknowns are R_X, inverse(Y)'s rotation, and the translations of both; the two rotations
    are made orthogonal at the end (A. Li, L. Wang and D. Wu, "Simultaneous robot-world and hand-eye
    calibration using dual-quaternions and Kronecker product", 2010). Arguments, result and errors
    as `solve_robot_world`.
    """
    w = _normalised_weights(A, weights)
    n = len(A)
    root = np.sqrt(w)[:, None, None]
    RA, RB, eye = A[:, :3, :3], B[:, :3, :3], np.eye(3)
    # with Z = inverse(Y), A Z = X B: R_A R_Z - R_X R_B = 0 and R_A t_Z - R_X t_B - t_X = -t_A
    system = np.zeros((n, 12, 24))
    system[:, :9, :9] = np.einsum("nij,kl->nikjl", RA, eye).reshape(n, 9, 9)
    system[:, :9, 9:18] = -np.einsum("ij,nlk->nikjl", eye, RB).reshape(n, 9, 9)
    system[:, 9:, 9:18] = -np.einsum("ij,nl->nijl", eye, B[:, :3, 3]).reshape(n, 3, 9)
    system[:, 9:, 18:21] = RA
    system[:, 9:, 21:] = -eye
    right = np.zeros((n, 12, 1))
    right[:, 9:, 0] = -A[:, :3, 3]
    solution = np.linalg.lstsq((root * system).reshape(-1, 24), (root * right).reshape(-1), rcond=None)[0]
    R_Z, R_X = (rotations.nearest(part.reshape(3, 3)) for part in (solution[:9], solution[9:18]))
    Z = transform(R_Z, solution[18:21])
    return RobotWorld(transform(R_X, solution[21:]), inverse(Z), _spectrum_of_rotations(RB, w))


def _normalised_weights(A: Array, weights: ArrayLike | None) -> Array:
    """Return weights (n,) that sum to 1."""
    if not len(A):
        raise ValueError("a robot-world problem without poses")
    w = np.ones(len(A)) if weights is None else np.asarray(weights, float)
    return np.asarray(w / w.sum())


def _solve_translations(A: Array, B: Array, w: Array, R_X: Array, R: Array) -> tuple[Array, Array]:
    """Solve for t_X and t_Y in ``t_A = R_X t_B + t_X + R t_Y`` by least squares, R (n, 3, 3)."""
    system = np.concatenate([np.broadcast_to(np.eye(3), R.shape), R], -1)
    right = A[:, :3, 3] - B[:, :3, 3] @ R_X.T
    root = np.sqrt(w)[:, None]
    solution = np.linalg.lstsq((root[..., None] * system).reshape(-1, 6), (root * right).ravel(), rcond=None)[0]
    return solution[:3], solution[3:]


def _spectrum_of_rotations(RB: Array, w: Array) -> Spectrum:
    """Compute the spectrum from the rotations of B.

    The motion spreads a direction a of B's child frame to R_B a, whose mean has the length
    cos(dispersion); so the singular values of the mean rotation determine all three.
    """
    _, lengths, Vt = np.linalg.svd(np.einsum("n,nij->ij", w, RB))
    sines = np.sqrt(np.clip((1 - lengths) * (1 + lengths), 0.0, None))
    return Spectrum(dispersion=np.arctan2(sines, lengths), axis=Vt[0])
