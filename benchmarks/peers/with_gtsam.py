"""gtsam: a factor graph from Python, one factor per view with analytic derivatives in numpy."""

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.floor import rows_of
from benchmarks.peers.peer import Peer, Solution
from benchmarks.rig_arrays import RigArrays
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import adjoint

TURN_FIRST = [3, 4, 5, 0, 1, 2]
"""gtsam's twists begin with the rotation."""


def gtsam() -> Peer | str:
    """The solver, or why there is none."""
    return _solve if find_spec("gtsam") else "gtsam is not installed: pip install gtsam"


def _solve(rig: RigArrays) -> Solution:
    import gtsam

    C, N = len(rig.T_camera_world), len(rig.T_world_board)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Unit.Create(rig.pixels[0].size)
    for key, T in enumerate((*rig.T_camera_world, *rig.T_world_board)):
        if key:  # the first camera is where it is
            values.insert(key, gtsam.Pose3(T))
    for c in range(C):
        for n in range(N):
            keys = [c, C + n] if c else [C + n]
            fixed = None if c else rig.T_camera_world[0]
            graph.add(gtsam.CustomFactor(noise, keys, _residuals(rig, rig.pixels[c * N + n], fixed)))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-8)
    begin = time.perf_counter()
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    seconds = time.perf_counter() - begin
    poses = [rig.T_camera_world[0], *(found.atPose3(key).matrix() for key in range(1, C + N))]
    return Solution(np.array(poses[:C]), np.array(poses[C:]), seconds)


def _residuals(rig: RigArrays, pixels: Array, fixed: Array | None) -> Callable[[Any, Any, list[Array] | None], Array]:
    """Return the function of the labels (2, K) of one view, of its camera's pose unless that is fixed, and its board's.

    gtsam moves a pose T to ``T exp(twist)``, which moves the view's pose by the adjoint in the camera's frame.
    """

    def evaluate(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        keys = factor.keys()
        *camera, board = (values.atPose3(key).matrix() for key in keys)
        of_camera = camera[0] if fixed is None else fixed
        view = of_camera @ board
        (rows,) = rows_of(view[None], rig.corners, pixels[None], rig.intrinsics)
        if jacobians is not None:
            moved = [view] if fixed is not None else [of_camera, view]
            for k, T in enumerate(moved):
                jacobians[k] = np.asfortranarray((rows[:6].T @ adjoint(T))[:, TURN_FIRST])
        return rows[6]

    return evaluate
