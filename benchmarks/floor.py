"""The unit of time: one numpy pass over the corners of all views, with derivatives.

For 4000 views of 50 corners: project with Brown's five distortion terms, subtract the labels,
differentiate both image axes to a twist of the view's pose, and multiply up each view's 7x7 Gram matrix
(six derivatives and the residual). No least squares in pixels can do with less than a few of these.
Written plainly in chunks of 128 views, which numpy is fastest with, and independent of the engine, so that
changes there do not move it.
"""

import numpy as np

from benchmarks.rig_arrays import RigArrays
from calibration.base.arrays import Array

CHUNK = 128


def gram_matrices(T: Array, corners: Array, pixels: Array, intrinsics: Array) -> Array:
    """The pass.

    Args:
        T: (V, 4, 4), ``T_camera_pattern``.
        corners: (K, 3), m.
        pixels: (V, 2, K), the labels.
        intrinsics: fx, fy, cx, cy, k1, k2, p1, p2, k3.

    Returns:
        (V, 7, 7): of the derivatives to a twist (translation, rotation) in the camera's frame, and the residual.
    """
    gram = np.empty((len(T), 7, 7))
    for start in range(0, len(T), CHUNK):
        views = slice(start, start + CHUNK)
        rows = rows_of(T[views], corners, pixels[views], intrinsics)
        gram[views] = rows @ rows.transpose(0, 2, 1)
    return gram


def rows_of(T: Array, corners: Array, pixels: Array, intrinsics: Array) -> Array:
    """Derivatives and residual of both image axes, (v, 7, 2K)."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(i) for i in intrinsics)
    p = T[:, :3, :3] @ corners.T + T[:, :3, 3:]
    inverse_z = 1.0 / p[:, 2]
    x, y = p[:, 0] * inverse_z, p[:, 1] * inverse_z
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    u = fx * (x * radial + 2 * p1 * xy + p2 * (r2 + 2 * xx)) + (cx - pixels[:, 0])
    v = fy * (y * radial + 2 * p2 * xy + p1 * (r2 + 2 * yy)) + (cy - pixels[:, 1])
    ux = fx * (radial + slope * xx + 2 * p1 * y + 6 * p2 * x)
    uy = fx * (slope * xy + 2 * p1 * x + 2 * p2 * y)
    vx = fy * (slope * xy + 2 * p1 * x + 2 * p2 * y)
    vy = fy * (radial + slope * yy + 2 * p2 * x + 6 * p1 * y)
    rows = np.empty((len(T), 7, 2, len(corners)))
    for axis, (jx, jy, residual) in enumerate(((ux, uy, u), (vx, vy, v))):
        jz = -(jx * x + jy * y)
        rows[:, 0, axis] = jx * inverse_z
        rows[:, 1, axis] = jy * inverse_z
        rows[:, 2, axis] = jz * inverse_z
        rows[:, 3, axis] = jz * y - jy
        rows[:, 4, axis] = jx - jz * x
        rows[:, 5, axis] = jy * x - jx * y
        rows[:, 6, axis] = residual
    return rows.reshape(len(T), 7, -1)


def one_pass(rig: RigArrays) -> Array:
    """The pass over all views of a rig at its start."""
    return gram_matrices(rig.views(rig.T_camera_world, rig.T_world_board), rig.corners, rig.pixels, rig.intrinsics)


def cost(rig: RigArrays, T_camera_world: Array, T_world_board: Array) -> float:
    """The sum of squared residuals in px^2 at some poses: one judge for all solvers."""
    T = rig.views(T_camera_world, T_world_board)
    return float(gram_matrices(T, rig.corners, rig.pixels, rig.intrinsics)[:, 6, 6].sum())
