"""Kinematics of a simulated system: poses of sensors and patterns in a played motion, and joints that reach a pose.

A played motion (`Play`) is all that a collection depends on, with the seed of its random generators, which are
independent of the order of use.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.transforms import adjoint, inverse, local
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.sensor import Views
from calibration.robot.simulation.system import System
from calibration.robot.urdf import Joint, Robot, compose


@dataclass(frozen=True, eq=False)
class Placement:
    """True poses at each of N poses of a motion; arrays are (N, 4, 4) unless stated otherwise."""

    transforms: Mapping[Edge, Array]
    """Transforms of the robot, by (parent, child)."""
    sensors: Mapping[str, Array]
    """``T_world_sensor``, to the frame of the sensor's data."""
    patterns: Mapping[str, Array]
    """``T_world_pattern``."""
    joints: Mapping[str, Array]
    """Positions (N,) of the movable joints, by name, rad or m."""

    def pattern_in(self, sensor: str, pattern: str) -> Array:
        """Return ``T_sensor_pattern``."""
        return inverse(self.sensors[sensor]) @ self.patterns[pattern]

    def sensors_are_free(self, scene: Scene) -> BoolArray:
        """Return a mask (N,) of the poses at which no sensor is in a box or under the ground."""
        origins = np.stack([T_world_sensor[:, :3, 3] for T_world_sensor in self.sensors.values()], 1)
        return np.asarray(~np.any(scene.contains(origins), axis=-1))


def views(system: System, placement: Placement, sensor: str, pattern: str) -> Views:
    """Return the views of a pattern by a sensor, at the poses of a placement."""
    return Views(
        system.configuration.patterns[pattern],
        system.patterns[pattern],
        system.scene,
        placement.sensors[sensor],
        placement.patterns[pattern],
    )


def place(system: System, motion: Motion) -> Placement:
    """Play a motion.

    Raises:
        InputError: the motion lacks something that the system moves, or moves something unknown, or a joint
            is outside its limits.
    """
    moved = system.moved_pattern
    if moved is None and motion.positions is not None:
        raise InputError(
            f"{motion.source}: found positions and orientations, "
            f"but every pattern of {system.name} is fixed; expected joints"
        )
    if moved is not None and motion.positions is None:
        raise InputError(
            f"{motion.source}: found no position and orientation; pattern '{moved.name}' of {system.name} moves by them"
        )
    transforms = system.robot.transforms(motion.joints, count=len(motion))
    tree, world = system.robot.tree, system.configuration.world_link

    def pose(frame: str) -> Array:
        return compose(tree, transforms, world, frame)

    patterns = {name: pose(p.link) for name, p in system.patterns.items() if p.fixed}
    model_poses = motion.model_poses
    if moved is not None and model_poses is not None:
        patterns[moved.name] = pose(moved.parent_link) @ model_poses @ system.T_model_pattern
    sensors = {name: pose(sensor.link) for name, sensor in system.configuration.sensors.items()}
    positions = {
        name: np.asarray(motion.joints.get(name, np.full(len(motion), joint.rest)), float)
        for name, joint in system.robot.movable.items()
    }
    return Placement(transforms, sensors, patterns, positions)


@dataclass(frozen=True, eq=False)
class Play:
    """Played motion: all that a collection at any of its N poses depends on."""

    system: System
    motion: Motion
    seed: int
    true: Placement
    """True poses."""
    nominal: Placement
    """Poses of the nominal robot."""

    def __len__(self) -> int:
        return len(self.motion)


def play(system: System, motion: Motion, seed: int) -> Play:
    """Play a motion with a system.

    Raises:
        InputError: the motion does not fit the system (see `place`), or brings a sensor into a box
            or under the ground.
    """
    true = place(system, motion)
    free = true.sensors_are_free(system.scene)
    if not free.all():
        raise InputError(f"{motion.source}: a sensor is in a box or under the ground in pose {free.argmin() + 1}")
    nominal = true if system.nominal is system.robot else place(replace(system, robot=system.nominal), motion)
    return Play(system, motion, seed, true, nominal)


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
    return np.asarray(step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300)))


@dataclass(frozen=True, eq=False)
class _ChainPart:
    """Part of the chain between two frames: a movable joint, or a constant."""

    constant: Array
    """(4, 4): the product of fixed transforms. Unused for a movable joint."""
    joint: Joint | None = None
    inverted: bool = False


def _merged_chain(robot: Robot, start: str, end: str) -> list[_ChainPart]:
    """Return the parts of the chain, with neighbouring constants multiplied."""
    way: list[_ChainPart] = []
    for step in robot.tree.path(start, end):
        joint = robot.by_edge[step.parent, step.child]
        if joint.is_movable:
            way.append(_ChainPart(np.eye(4), joint, step.inverted))
            continue
        constant = inverse(joint.T_parent_joint) if step.inverted else joint.T_parent_joint
        if way and way[-1].joint is None:
            way[-1] = _ChainPart(way[-1].constant @ constant)
        else:
            way.append(_ChainPart(constant))
    return way


def _linearise(way: list[_ChainPart], targets: Array, q: Array, index: Mapping[str, int]) -> tuple[Array, Array]:
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


def stream(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return the generator for a purpose, such as (collection, sensor); equal in any process and order."""
    key = [p if isinstance(p, int) else crc32(p.encode()) for p in purpose]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
