"""SE(3) as 4x4 homogeneous matrices ``T_parent_child``, (..., 4, 4); composition is ``@``."""

import numpy as np

from calibration.base.arrays import Array, ArrayLike
from calibration.engine.geometry import rotations


def transform(R: ArrayLike, t: ArrayLike) -> Array:
    """Compose transforms of rotations (..., 3, 3) and translations (..., 3); batch axes broadcast."""
    R, t = np.asarray(R, float), np.asarray(t, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def translation(t: ArrayLike) -> Array:
    """Return pure translations (..., 3) as transforms."""
    return transform(np.eye(3), t)


def from_quaternion(t: ArrayLike, q: ArrayLike) -> Array:
    """Convert a translation (..., 3) and a quaternion [x, y, z, w] (..., 4) to a transform."""
    return transform(rotations.from_quaternion(q), t)


def from_xyz_rpy(xyz: ArrayLike, rpy: ArrayLike) -> Array:
    """Convert a translation and roll, pitch, yaw about fixed axes, as in URDF's ``<origin>``, to a transform."""
    return transform(rotations.from_rpy(rpy), xyz)


def inverse(T: Array) -> Array:
    """Return ``T_child_parent`` from ``T_parent_child``, without a matrix inversion."""
    out = np.empty_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3:])[..., 0]
    out[..., 3, :] = (0.0, 0.0, 0.0, 1.0)
    return out


def apply(T: Array, points: Array) -> Array:
    """Transform points (..., N, 3) from the child frame to the parent frame."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def adjoint(T: Array) -> Array:
    """Return the adjoint (..., 6, 6), which maps a twist in the child frame to one in the parent frame.

    For a twist (dt, dw) it is ``[[R, hat(t) R], [0, R]]`` (translation first).
    """
    R = T[..., :3, :3]
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    # hat(t) @ R row by row: cheaper than the product with a matrix of zeros
    x, y, z = T[..., 0, 3, None], T[..., 1, 3, None], T[..., 2, 3, None]
    A[..., 0, 3:] = y * R[..., 2, :] - z * R[..., 1, :]
    A[..., 1, 3:] = z * R[..., 0, :] - x * R[..., 2, :]
    A[..., 2, 3:] = x * R[..., 1, :] - y * R[..., 0, :]
    return A


def inverse_adjoint(T: Array) -> Array:
    """Return ``adjoint(inverse(T))`` (..., 6, 6), which maps a twist in the parent frame to one in the child frame."""
    R = T[..., :3, :3]
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = np.swapaxes(R, -1, -2)
    A[..., :3, 3:] = np.swapaxes(rotations.hat(T[..., :3, 3]) @ R, -1, -2)
    return A


def twists_in_child(T: Array, twists: Array) -> Array:
    """Return ``adjoint(inverse(T)) @ twists`` (n, 6, k), for poses (n, 4, 4) and a few twists (6, k).

    A twist (dt, dw) in the parent frame is ``(R^T (dt + dw x t), R^T dw)`` in the child frame.
    """
    k = twists.shape[-1]
    crossed = rotations.hat(twists[3:].T).transpose(2, 1, 0).reshape(3, -1)  # t @ crossed: dw x t, by axis and twist
    in_parent = np.empty((len(T), 3, 2 * k))
    in_parent[..., :k] = (T[:, :3, 3] @ crossed).reshape(-1, 3, k) + twists[:3]
    in_parent[..., k:] = twists[3:]
    turned = T[:, :3, :3].transpose(0, 2, 1) @ in_parent
    return turned.reshape(-1, 3, 2, k).transpose(0, 2, 1, 3).reshape(-1, 6, k)


def retract(T: Array, twist: Array) -> Array:
    """Perturb each transform by a twist (..., 6) in its child frame: ``T @ [exp(dw), dt]``.

    This is the product chart of R^3 x SO(3), equal to SE(3)'s exponential to first order and
    cheaper; `local` is its inverse.
    """
    step = np.zeros((*twist.shape[:-1], 4, 4))
    step[..., :3, :3], step[..., :3, 3], step[..., 3, 3] = rotations.exp(twist[..., 3:]), twist[..., :3], 1.0
    return T @ step


def local(T0: Array, T: Array) -> Array:
    """Return the twist (..., 6) for which ``retract(T0, twist) == T``."""
    D = inverse(T0) @ T
    return np.concatenate([D[..., :3, 3], rotations.log(D[..., :3, :3])], -1)


def distance(T0: Array, T: Array) -> tuple[Array, Array]:
    """Return the distance between two poses: norm of the translation (m) and angle (rad) of ``inverse(T0) @ T``."""
    twist = local(T0, T)
    return np.linalg.norm(twist[..., :3], axis=-1), np.linalg.norm(twist[..., 3:], axis=-1)
