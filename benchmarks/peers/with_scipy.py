"""scipy's least_squares on a rig: sparse numeric Jacobian, vectorised residuals, rotation vectors."""

import time

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix

from benchmarks.rig_arrays import RigArrays
from benchmarks.scenes import CAMERA
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, transform


def solve(rig: RigArrays) -> tuple[Array, Array, float]:
    """Solve as usual (and as ATOM does): trf, differences by groups of columns, x_scale='jac', default tolerances.

    Returns:
        ``T_camera_world`` (C, 4, 4), ``T_world_board`` (N, 4, 4), and the seconds.
    """
    free = len(rig.T_camera_world) - 1
    labels = np.ascontiguousarray(rig.pixels.transpose(0, 2, 1))

    def poses(x: Array) -> tuple[Array, Array]:
        q = x.reshape(-1, 6)
        T = transform(rotations.exp(q[:, 3:]), q[:, :3])
        return np.concatenate([rig.T_camera_world[:1], T[:free]]), T[free:]

    def residuals(x: Array) -> Array:
        p = apply(rig.views(*poses(x)), rig.corners)
        error: Array = CAMERA.to_pixels(p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]) - labels
        return error.ravel()

    start = np.concatenate([rig.T_camera_world[1:], rig.T_world_board])
    x = np.concatenate([start[:, :3, 3], rotations.log(start[:, :3, :3])], -1).ravel()
    sparsity = _sparsity(rig)
    begin = time.perf_counter()
    result = least_squares(residuals, x, jac="2-point", jac_sparsity=sparsity, x_scale="jac", method="trf")
    return *poses(result.x), time.perf_counter() - begin


def _sparsity(rig: RigArrays) -> csr_matrix:
    """Sparsity of the Jacobian: residuals depend on the parameters of their camera and of their board."""
    C, N, residuals = len(rig.T_camera_world), len(rig.T_world_board), 2 * len(rig.corners)
    camera, board = np.divmod(np.arange(C * N), N)
    blocks = np.stack([camera - 1, C - 1 + board], -1)  # the first camera stays: block -1
    rows = np.arange(C * N * residuals).reshape(C * N, residuals, 1, 1)
    columns = (6 * blocks[..., None] + np.arange(6))[:, None]
    rows, columns = np.broadcast_arrays(rows, columns)
    free = columns.ravel() >= 0
    entries = (np.ones(np.count_nonzero(free), np.int8), (rows.ravel()[free], columns.ravel()[free]))
    return csr_matrix(entries, shape=(C * N * residuals, 6 * (C - 1 + N)))
