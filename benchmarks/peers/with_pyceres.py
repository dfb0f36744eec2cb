"""pyceres: ceres from Python, one block of residuals per view with analytic derivatives in numpy."""

import time
from collections.abc import Sequence
from importlib.util import find_spec

import numpy as np

from benchmarks.floor import rows_of
from benchmarks.peers.peer import Peer, PeerError, Solution
from benchmarks.peers.with_ceres import pose_vectors, poses_of
from benchmarks.rig_arrays import RigArrays
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations


def pyceres() -> Peer | str:
    """The solver, or why there is none."""
    return _solve if find_spec("pyceres") else "pyceres is not installed: pip install pyceres"


def _solve(rig: RigArrays) -> Solution:
    import pyceres

    class View(pyceres.CostFunction):
        """Labels (2, K) of one view."""

        def __init__(self, pixels: Array) -> None:
            super().__init__()
            self.pixels = pixels[None]
            self.set_num_residuals(pixels.size)
            self.set_parameter_block_sizes([6, 6])

        def Evaluate(self, parameters: Sequence[Array], residuals: Array, jacobians: Sequence[Array] | None) -> bool:
            """Fill the residuals and the Jacobians by the poses of the camera and of the board."""
            T = poses_of(np.array(parameters))
            view = T[0] @ T[1]
            (rows,) = rows_of(view[None], rig.corners, self.pixels, rig.intrinsics)
            residuals[:] = rows[6]
            for jacobian, twists in zip(jacobians or (), _twists(T, view, np.array(parameters)[:, :3]), strict=False):
                if jacobian is not None:
                    jacobian[:] = (rows[:6].T @ twists).ravel()
            return True

    C, N = len(rig.T_camera_world), len(rig.T_world_board)
    poses = list(pose_vectors(rig))
    problem, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    for c in range(C):
        for n in range(N):
            problem.add_residual_block(View(rig.pixels[c * N + n]), None, [poses[c], poses[C + n]])
    problem.set_parameter_block_constant(poses[0])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.function_tolerance = 1e-8
    options.num_threads = 1
    begin = time.perf_counter()
    pyceres.solve(options, problem, summary)
    seconds = time.perf_counter() - begin
    if not summary.IsSolutionUsable():
        raise PeerError(f"pyceres failed: {summary.BriefReport()}")
    T = poses_of(np.array(poses))
    return Solution(T[:C], T[C:], seconds)


def _twists(T: Array, view: Array, vectors: Array) -> tuple[Array, Array]:
    """Twists (6, 6) of a view's pose, in the camera's frame, by rotation vector and translation of camera and board."""
    camera = T[0]
    turns = _left_jacobian(vectors)
    of_camera, of_board = turns[0], camera[:3, :3] @ turns[1]
    zero = np.zeros((3, 3))
    return (
        np.block([[rotations.hat(camera[:3, 3]) @ of_camera, np.eye(3)], [of_camera, zero]]),
        np.block([[rotations.hat(view[:3, 3]) @ of_board, camera[:3, :3]], [of_board, zero]]),
    )


def _left_jacobian(w: Array) -> Array:
    """Return the matrices (n, 3, 3) from a change of rotation vectors (n, 3) to the rotation that it adds on the left.

    ``J = I + (1 - cos a) / a^2 [w] + (a - sin a) / a^3 [w]^2`` with the angle a (T. Barfoot, "State estimation for
    robotics", 2017, eq. 7.77).
    """
    a = np.maximum(np.linalg.norm(w, axis=-1), 1e-6)[:, None, None]
    W = rotations.hat(w)
    J: Array = np.eye(3) + (1 - np.cos(a)) / a**2 * W + (a - np.sin(a)) / a**3 * W @ W
    return J
