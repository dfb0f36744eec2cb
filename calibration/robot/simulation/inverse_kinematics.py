"""Inverse kinematics: joint positions that move one frame of a robot to a pose in another."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.geometry.transforms import adjoint, inverse, local
from calibration.robot.urdf import Joint, Robot

_MAX_ITERATIONS = 20
_LONGEST_STEP = 0.5  # rad or m: limit of a step, for which the linearisation is valid
_MAX_POSE_ERROR = 1e-8  # m and rad
_MIN_STEP = 1e-11  # m and rad: convergence is quadratic, so the remaining error is about the square of the last step


def joints_between(robot: Robot, start: str, end: str) -> list[Joint]:
    """Return the joints whose positions move one frame in the other, in the order of the chain, each once."""
    drivers = dict.fromkeys(step.joint.driver for step in _merged_chain(robot, start, end) if step.joint is not None)
    return [robot.movable[name] for name in drivers if name in robot.movable]


def reach(
    robot: Robot, start: str, end: str, targets: Array, random: np.random.Generator
) -> tuple[dict[str, Array], BoolArray]:
    """Solve for joint positions with ``T_start_end`` equal to each of the targets (N, 4, 4).

    Least squares on the twist between pose and target, from one random initial guess per target, all
    at once. The damping is proportional to the squared error, so that the last steps are Gauss-Newton steps (J. Fan
    and Y. Yuan, "On the quadratic convergence of the Levenberg-Marquardt method", 2005).

    Returns:
        The positions (N,) of the joints between the two frames, by name; and a mask (N,) of the targets
        reached within the joints' limits. Others may be out of reach, or only not reached from this
        initial guess.
    """
    way = _merged_chain(robot, start, end)
    joints = joints_between(robot, start, end)
    index = {joint.name: i for i, joint in enumerate(joints)}
    low = np.array([max(joint.lower, -np.pi) for joint in joints])
    high = np.array([min(joint.upper, np.pi) for joint in joints])
    q = low + (high - low) * random.random((len(targets), len(joints)))
    moving = np.arange(len(targets))
    for _ in range(_MAX_ITERATIONS):
        error, J = _linearise(way, targets[moving], q[moving], index)
        open_ = np.abs(error).max(-1) > _MIN_STEP
        moving, error, J = moving[open_], error[open_], J[open_]
        q[moving] += _damped_step(error, J)
    turning = np.array([joint.kind != "prismatic" for joint in joints])
    q = np.where(turning, (q + np.pi) % (2 * np.pi) - np.pi, q)
    error, _ = _linearise(way, targets, q, index)
    reached = (np.abs(error).max(-1) < _MAX_POSE_ERROR) & ((q >= low) & (q <= high)).all(-1)
    return {joint.name: q[:, i] for i, joint in enumerate(joints)}, reached


def _damped_step(error: Array, J: Array) -> Array:
    """Return the damped step (N, J), with each component limited to the linearisation's range."""
    transposed = J.swapaxes(-1, -2)
    damping = 0.1 * (error * error).sum(-1) + 1e-12
    normal = transposed @ J + damping[:, None, None] * np.eye(J.shape[-1])
    step = np.linalg.solve(normal, transposed @ error[..., None])[..., 0]
    longest = np.abs(step).max(-1, keepdims=True)
    shortened: Array = step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))
    return shortened


@dataclass(frozen=True, eq=False)
class _Step:
    """Part of the chain between two frames: a movable joint, or a constant."""

    constant: Array
    """(4, 4): the product of fixed transforms. Unused for a movable joint."""
    joint: Joint | None = None
    inverted: bool = False


def _merged_chain(robot: Robot, start: str, end: str) -> list[_Step]:
    """Return the parts of the chain, with neighbouring constants multiplied."""
    way: list[_Step] = []
    for step in robot.tree.path(start, end):
        joint = robot.by_edge[step.parent, step.child]
        if joint.is_movable:
            way.append(_Step(np.eye(4), joint, step.inverted))
            continue
        constant = inverse(joint.T_parent_joint) if step.inverted else joint.T_parent_joint
        if way and way[-1].joint is None:
            way[-1] = _Step(way[-1].constant @ constant)
        else:
            way.append(_Step(constant))
    return way


def _linearise(way: list[_Step], targets: Array, q: Array, index: Mapping[str, int]) -> tuple[Array, Array]:
    """Return the twist (N, 6) from the pose to the target, and the Jacobian (N, 6, J) of the pose by the joints.

    ``index`` is the place of each joint's position in q; a joint that mimics another one adds to that one's column.
    """
    T = np.broadcast_to(np.eye(4), targets.shape)
    moved: list[tuple[int, Array, Array]] = []  # column, frame relative to the start and twist there of each joint
    for step in way:
        if step.joint is None:
            T = T @ step.constant
            continue
        column = index[step.joint.driver]
        position, twist = q[:, column], step.joint.twist
        if (mimic := step.joint.mimic) is not None:
            position, twist = mimic.positions(position), mimic.multiplier * twist
        T_parent_child = step.joint.transform(position)
        if step.inverted:
            moved.append((column, T, -twist))
            T = T @ inverse(T_parent_child)
        else:
            T = T @ T_parent_child
            moved.append((column, T, twist))
    T_end_start = inverse(T)
    J = np.zeros((len(targets), 6, len(index)))
    for column, T_start_joint, twist in moved:
        J[..., column] += adjoint(T_end_start @ T_start_joint) @ twist
    return local(T, targets), J
