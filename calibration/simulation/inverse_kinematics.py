"""Joint positions that bring one frame of a robot to a pose in another."""

import numpy as np

from calibration.geometry.transforms import adjoint, local
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.robot import Joint, Robot, compose

_ITERATIONS = 60
_LONGEST_STEP = 0.5  # rad or m: a linearisation says nothing about more
_REACHED = 1e-8  # m and rad


def joints_between(robot: Robot, start: str, end: str) -> list[Joint]:
    """The joints with a position on the way between two frames, in the order of the way."""
    by_edge = {joint.edge: joint for joint in robot.movable.values()}
    steps = ((step.parent, step.child) for step in robot.tree.path(start, end))
    return [by_edge[edge] for edge in steps if edge in by_edge]


def reach(
    robot: Robot, start: str, end: str, targets: Array, random: np.random.Generator
) -> tuple[dict[str, Array], BoolArray]:
    """Joint positions for which ``T_start_end`` is each of the targets (N, 4, 4).

    Least squares on the twist between pose and target, from one random start for each target, all
    at once; damping in proportion to the squared error makes the last steps Gauss-Newton's (J. Fan
    and Y. Yuan, "On the quadratic convergence of the Levenberg-Marquardt method", 2005).

    Returns:
        The positions (N,) of the joints between the two frames, by name; and which targets (N,)
        are reached within the joints' limits. A target that is not may be out of reach, or only
        out of reach from its start.
    """
    joints = joints_between(robot, start, end)
    low = np.array([max(joint.lower, -np.pi) for joint in joints])
    high = np.array([min(joint.upper, np.pi) for joint in joints])
    q = low + (high - low) * random.random((len(targets), len(joints)))
    for _ in range(_ITERATIONS):
        error, J = _linearise(robot, joints, start, end, targets, q)
        damping = 0.1 * (error * error).sum(-1) + 1e-12
        normal = J.swapaxes(-1, -2) @ J + damping[:, None, None] * np.eye(len(joints))
        step = np.linalg.solve(normal, J.swapaxes(-1, -2) @ error[..., None])[..., 0]
        length = np.abs(step).max(-1, keepdims=True)
        q = q + step * np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-300))
    turning = np.array([joint.kind != "prismatic" for joint in joints])
    q = np.where(turning, (q + np.pi) % (2 * np.pi) - np.pi, q)
    error, _ = _linearise(robot, joints, start, end, targets, q)
    reached = (np.abs(error).max(-1) < _REACHED) & ((q >= low) & (q <= high)).all(-1)
    return {joint.name: q[:, i] for i, joint in enumerate(joints)}, reached


def _linearise(
    robot: Robot, joints: list[Joint], start: str, end: str, targets: Array, q: Array
) -> tuple[Array, Array]:
    """The twist (N, 6) from the pose to the target, and how joints (J,) move the pose: (N, 6, J)."""
    position = {joint.edge: q[:, i] for i, joint in enumerate(joints)}
    transforms = {
        joint.edge: joint.transform(position.get(joint.edge, np.full(len(q), joint.rest))) for joint in robot.joints
    }
    upwards = {(step.parent, step.child) for step in robot.tree.path(start, end) if step.inverted}
    columns = []
    for joint in joints:
        T_end_joint = compose(robot.tree, transforms, end, joint.child)
        columns.append(adjoint(T_end_joint) @ (-joint.twist if joint.edge in upwards else joint.twist))
    return local(compose(robot.tree, transforms, start, end), targets), np.stack(columns, -1)
