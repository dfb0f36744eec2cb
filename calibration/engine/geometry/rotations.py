"""SO(3): rotation matrices, rotation vectors, quaternions, Euler angles.

Rotation matrices are (..., 3, 3); rotation vectors (axis times angle, radians) are (..., 3).
"""

import numpy as np

from calibration.base.arrays import Array, ArrayLike

_CROSSED = np.array([[0, 2, 1], [2, 1, 0], [1, 0, 2]])
"""Elements of a vector in the matrix of its cross product, with `_SIGNS`."""
_SIGNS = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])


def hat(w: ArrayLike) -> Array:
    """Return the cross-product matrix (..., 3, 3): ``hat(w) @ v == cross(w, v)``."""
    return np.asarray(np.asarray(w, float).take(_CROSSED, -1) * _SIGNS)


def exp(w: ArrayLike) -> Array:
    """Convert rotation vectors (..., 3) to rotation matrices (Rodrigues' formula)."""
    w = np.asarray(w, float)
    angle2 = (w * w).sum(-1)
    angle = np.sqrt(angle2)
    small = angle < 1e-4  # below it the truncated series is exact to machine precision
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / (safe * safe))
    W = hat(w)
    return np.asarray(np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W))


def log(R: ArrayLike) -> Array:
    """Convert rotation matrices to rotation vectors, of length at most pi; accurate near 0 and near pi.

    Uses the quaternion, whose vector part is ``sin(angle / 2) * axis``.
    """
    q = to_quaternion(R)
    v, w = q[..., :3], q[..., 3]
    s = np.linalg.norm(v, axis=-1)
    small = s < 1e-9
    factor = np.where(small, 2 / np.maximum(w, 0.5), 2 * np.arctan2(s, w) / np.where(small, 1.0, s))
    return v * factor[..., None]


def angle(R: ArrayLike) -> Array:
    """Return the angle of each rotation, in [0, pi]."""
    return np.asarray(np.linalg.norm(log(R), axis=-1))


def from_quaternion(q: ArrayLike) -> Array:
    """Convert quaternions [x, y, z, w] (..., 4), of any length but 0, to rotation matrices."""
    q = np.asarray(q, float)
    unit = q / np.linalg.norm(q, axis=-1, keepdims=True)
    x, y, z, w = (unit[..., i] for i in range(4))
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    R[..., 0, 1], R[..., 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
    R[..., 0, 2], R[..., 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
    R[..., 1, 2], R[..., 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
    return R


def to_quaternion(R: ArrayLike) -> Array:
    """Convert rotation matrices to unit quaternions [x, y, z, w] with w >= 0.

    The largest of the four components is computed from the diagonal, the others follow from it
    (S. W. Shepperd, "Quaternion from rotation matrix", 1978), so no digit is lost at any angle.
    """
    R = np.asarray(R, float)
    d = np.diagonal(R, axis1=-2, axis2=-1)
    trace = d.sum(-1)
    squares = np.concatenate([1 + 2 * d - trace[..., None], 1 + trace[..., None]], -1)  # 4 q_i^2
    off = R - np.swapaxes(R, -1, -2)  # differences: 4 q_w q_i
    on = R + np.swapaxes(R, -1, -2)  # sums: 4 q_i q_j
    products = np.empty((*R.shape[:-2], 4, 4))  # row i: 4 q_i * (q_x, q_y, q_z, q_w)
    products[..., :3, :3] = on
    for i in range(4):
        products[..., i, i] = squares[..., i]
    for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):
        products[..., i, 3] = products[..., 3, i] = off[..., j, k]
    best = squares.argmax(-1)
    row = np.take_along_axis(products, best[..., None, None], -2)[..., 0, :]
    q = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def from_rpy(rpy: ArrayLike) -> Array:
    """Convert roll, pitch, yaw (..., 3) about the fixed axes x, y, z (URDF's, tf's "sxyz") to ``Rz @ Ry @ Rx``."""
    rpy = np.asarray(rpy, float)
    axes = np.eye(3)
    Rx, Ry, Rz = (exp(rpy[..., i, None] * axes[i]) for i in range(3))
    return Rz @ Ry @ Rx


def to_rpy(R: ArrayLike) -> Array:
    """Invert `from_rpy`, with pitch in [-pi/2, pi/2]; at the singularity yaw is 0."""
    R = np.asarray(R, float)
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    singular = cos_pitch < 1e-9
    roll = np.where(singular, np.arctan2(-R[..., 1, 2], R[..., 1, 1]), np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    yaw = np.where(singular, 0.0, np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    return np.stack([roll, pitch, yaw], -1)


def rpy_rates(rpy: ArrayLike) -> Array:
    """Jacobian (3, 3) of roll, pitch and yaw with respect to a small rotation in the body frame: d rpy / d w.

    For ``R exp(w)`` with ``R = from_rpy(rpy)``. Unbounded at pitch +-pi/2.

    Args:
        rpy: (3,), rad.
    """
    roll, pitch, _ = np.asarray(rpy, float)
    (sr, cr), (sp, cp) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.array([[1.0, sr * sp / cp, cr * sp / cp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]])


def nearest(M: ArrayLike) -> Array:
    """Return the rotation nearest to each 3x3 matrix in the Frobenius norm (orthogonal Procrustes)."""
    U, _, Vt = np.linalg.svd(np.asarray(M, float))
    sign = np.ones(U.shape[:-1])
    with np.errstate(invalid="ignore"):  # NaN is propagated; on some processors LAPACK warns of it
        sign[..., 2] = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0, -1.0, 1.0)
    return np.asarray((U * sign[..., None, :]) @ Vt)


def towards(directions: Array) -> Array:
    """Return the smallest rotations (v, 3, 3) that turn the z axis to directions (v, 3)."""
    across = np.stack([-directions[:, 1], directions[:, 0], np.zeros(len(directions))], -1)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    return exp(across / np.maximum(length, 1e-12) * np.arctan2(length, directions[:, 2:]))
