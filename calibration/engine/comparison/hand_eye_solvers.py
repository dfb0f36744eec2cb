"""Five solvers of the hand-eye problem ``A X = X B``, from relative motions of hand and eye.

They are used where OpenCV lacks them: OpenCV 4 has the same five in `calibrateHandEye`, with equal results
(newer ones skip some motions for Tsai), OpenCV 5 none. Each is implemented from its paper and takes
`relative_motions`; a motion that does not determine X yields some finite transform.
"""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.rotations import hat
from calibration.engine.geometry.transforms import inverse, transform

MOST_MOTIONS = 20_000
"""Limit of relative motions: all pairs of up to 200 views; with more, pairs of views close in order."""


def relative_motions(hand: Array, eye: Array) -> tuple[Array, Array]:
    """Return the relative motions between pairs of views.

    Args:
        hand: (n, 4, 4), ``T_hand_base``.
        eye: (n, 4, 4), ``T_eye_target``.

    Returns:
        A and B, (m, 4, 4) each: of the hand, ``T_hand_hand'``, and of the eye, ``T_eye_eye'``.
    """
    n = len(hand)
    i, j = np.triu_indices(n, 1)
    if len(i) > MOST_MOTIONS:
        near = j - i <= max(1, MOST_MOTIONS // n)
        i, j = i[near], j[near]
    return hand[j] @ inverse(hand[i]), eye[j] @ inverse(eye[i])


def solve_tsai(A: Array, B: Array) -> Array:
    """Solve for X (4, 4), the rotation linearly as a modified Rodrigues vector (R. Tsai and R. Lenz, 1989)."""
    a, b = _sine_vectors(A), _sine_vectors(B)
    p = np.linalg.lstsq(hat(a + b).reshape(-1, 3), (b - a).ravel(), rcond=None)[0]
    R = rotations.from_quaternion(np.append(p, 1.0))  # p = tan(angle / 2) axis
    return transform(R, _solve_translation(A, B, R))


def solve_park(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) by aligning the rotation vectors of the motions (F. Park and B. Martin, 1994)."""
    a, b = (rotations.log(T[:, :3, :3]) for T in (A, B))
    R = rotations.nearest(a.T @ b)
    return transform(R, _solve_translation(A, B, R))


def solve_horaud(A: Array, B: Array) -> Array:
    """Solve for X (4, 4), the rotation as the quaternion that fits ``a x = x b`` (R. Horaud, F. Dornaika, 1995)."""
    a, b = (rotations.to_quaternion(T[:, :3, :3]) for T in (A, B))
    difference = (_from_left(a) - _from_right(b)).reshape(-1, 4)
    R = rotations.from_quaternion(np.linalg.eigh(difference.T @ difference)[1][:, 0])
    return transform(R, _solve_translation(A, B, R))


def solve_andreff(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) by one linear system, projected to a rotation afterwards (N. Andreff et al., 1999)."""
    m, eye = len(A), np.eye(3)
    RA, RB, tA, tB = A[:, :3, :3], B[:, :3, :3], A[:, :3, 3], B[:, :3, 3]
    system = np.zeros((m, 12, 12))
    system[:, :9, :9] = np.eye(9) - np.einsum("nij,nkl->nikjl", RA, RB).reshape(m, 9, 9)
    system[:, 9:, :9] = np.einsum("ij,nk->nijk", eye, tB).reshape(m, 3, 9)
    system[:, 9:, 9:] = eye - RA
    right = np.concatenate([np.zeros((m, 9)), tA], -1)
    solution = np.linalg.lstsq(system.reshape(-1, 12), right.ravel(), rcond=None)[0]
    return transform(rotations.nearest(solution[:9].reshape(3, 3)), solution[9:])


def solve_daniilidis(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) as a unit dual quaternion (K. Daniilidis, 1999).

    The solution is a combination of two singular vectors, fixed by two quadratic conditions:
    the real part has unit norm and is orthogonal to the dual part.
    """
    (a, a_dual), (b, b_dual) = _dual_quaternion(A), _dual_quaternion(B)
    system = np.zeros((len(A), 6, 8))
    for (row, column), (x, y) in {(0, 0): (a, b), (3, 0): (a_dual, b_dual), (3, 4): (a, b)}.items():
        system[:, row : row + 3, column] = (x - y)[:, :3]
        system[:, row : row + 3, column + 1 : column + 4] = hat((x + y)[:, :3])
    u, v = np.linalg.svd(system.reshape(-1, 8), full_matrices=False)[2][-2:].reshape(2, 2, 4)
    if abs(v[0] @ v[1]) < abs(u[0] @ u[1]):  # x = u + s v or v + s u: the quadratic that is better conditioned
        u, v = v, u
    (u1, u2), (v1, v2) = u, v
    square, linear, constant = v1 @ v2, u1 @ v2 + v1 @ u2, u1 @ u2
    root = np.sqrt(max(0.0, linear * linear - 4 * square * constant))
    candidates = [(-linear + sign * root) / (2 * square) if square else 0.0 for sign in (1, -1)]
    s = max(candidates, key=lambda s: float(((u1 + s * v1) ** 2).sum() / (1 + s * s)))
    q, q_dual = _as_xyzw(u1 + s * v1), _as_xyzw(u2 + s * v2)
    conjugate: Array = np.append(-q[:3], q[3])
    t = (_from_right(conjugate) @ q_dual)[:3] * (2 / float(q @ q))
    return transform(rotations.from_quaternion(q), t)


def _solve_translation(A: Array, B: Array, R: Array) -> Array:
    """Solve ``(R_A - I) t = R t_B - t_A`` for t by least squares."""
    system = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0], float)


def _sine_vectors(T: Array) -> Array:
    """Return ``2 sin(angle / 2) axis`` of the rotations (n, 3)."""
    return 2 * rotations.to_quaternion(T[:, :3, :3])[:, :3]


def _from_left(q: Array) -> Array:
    """Return the matrices (..., 4, 4) with ``_from_left(q) @ p == q p``, quaternions as [x, y, z, w]."""
    return _product_matrix(q, 1)


def _from_right(q: Array) -> Array:
    """Return the matrices (..., 4, 4) with ``_from_right(q) @ p == p q``."""
    return _product_matrix(q, -1)


def _product_matrix(q: Array, side: int) -> Array:
    M = np.zeros((*q.shape, 4))
    M[..., :3, :3] = side * hat(q[..., :3])
    M[..., :3, 3], M[..., 3, :3] = q[..., :3], -q[..., :3]
    M[..., range(4), range(4)] = q[..., 3, None]
    return M


def _dual_quaternion(T: Array) -> tuple[Array, Array]:
    """Return the quaternions [x, y, z, w] of the rotations and their dual parts ``t q / 2``."""
    q = rotations.to_quaternion(T[:, :3, :3])
    t = np.concatenate([T[:, :3, 3], np.zeros((len(T), 1))], -1)
    return q, 0.5 * np.einsum("nij,nj->ni", _from_left(t), q)


def _as_xyzw(q: Array) -> Array:
    """Convert from [w, x, y, z], the order in the equations of Daniilidis."""
    return np.roll(q, -1)
