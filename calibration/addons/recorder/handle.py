"""Handle that a user drags to set a pose: the moved pattern, or a frame that the robot's joints move.

The handle of a pattern is at the centre of its front, not at the origin of its frame, so that
rotations keep it in the field of view.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import inverse, translation
from calibration.robot.simulation.inverse_kinematics import joints_between, reach
from calibration.robot.simulation.motion.sequence import Motion, moving_model
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.robot import Joint, compose
from calibration.robot.simulation.system import System

_SEARCHES = 64
"""Number of searches for joint positions: the nearest solution of an arm is nearly always found."""


@dataclass(frozen=True, eq=False)
class Handle:
    """Frame that a user drags and rotates."""

    frame: str
    """Link of the handle; for a moved pattern it is not a link of the robot."""
    T_frame_handle: Array
    """(4, 4)."""
    moves_pattern: bool
    """Whether it moves a free pattern; otherwise joints follow by inverse kinematics."""


def find_handle(system: System) -> Handle | None:
    """Return the moved pattern; else the first pattern or sensor that joints move; None if nothing moves."""
    moved = system.moved_pattern
    if moved is not None:
        return Handle(moved.link, _middle_of_pattern(system, moved.name), moves_pattern=True)
    frames = {pattern.link: _middle_of_pattern(system, name) for name, pattern in system.patterns.items()}
    frames |= {sensor.link: np.eye(4) for sensor in system.configuration.sensors.values()}
    for frame, T_frame_handle in frames.items():
        if joints_between(system.robot, system.configuration.world_link, frame):
            return Handle(frame, T_frame_handle, moves_pattern=False)
    return None


def handle_pose(system: System, handle: Handle, pose: Motion) -> Array:
    """Return ``T_world_handle`` (4, 4) at a pose, which is a motion of length one."""
    placement = place(system, pose)
    if handle.moves_pattern:
        moved = next(name for name, pattern in system.patterns.items() if pattern.link == handle.frame)
        T_world_frame = placement.patterns[moved]
    else:
        T_world_frame = compose(system.robot.tree, placement.transforms, system.configuration.world_link, handle.frame)
    T_world_handle: Array = T_world_frame[0] @ handle.T_frame_handle
    return T_world_handle


def drag(system: System, handle: Handle, pose: Motion, T_world_handle: Array) -> Motion | None:
    """Return the pose with the handle there, nearest to the previous one; None if no joint positions reach it."""
    T_world_frame = T_world_handle @ inverse(handle.T_frame_handle)
    if handle.moves_pattern:
        moved = moving_model(_model_pose(system, pose, T_world_frame)[None])
        return replace(pose, positions=moved.positions, orientations=moved.orientations)
    world = system.configuration.world_link
    joints = joints_between(system.robot, world, handle.frame)
    targets = np.broadcast_to(T_world_frame, (_SEARCHES, 4, 4))
    positions, reached = reach(system.robot, world, handle.frame, targets, stream(1, "handle"))
    if not reached.any():
        return None
    before = {joint.name: float(pose.joints[joint.name][0]) for joint in joints}
    found = {joint.name: _nearest_turn(joint, positions[joint.name][reached], before[joint.name]) for joint in joints}
    way = sum(np.abs(found[name] - before[name]) for name in found)
    nearest = int(np.argmin(way))
    return replace(pose, joints={**pose.joints, **{name: values[[nearest]] for name, values in found.items()}})


def _middle_of_pattern(system: System, pattern: str) -> Array:
    """``T_pattern_handle``."""
    x, y = system.patterns[pattern].outline.mean(axis=0)
    return translation(np.array([x, y, 0.0]))


def _model_pose(system: System, pose: Motion, T_world_pattern: Array) -> Array:
    """Return ``T_parent_model`` (4, 4) of the moved pattern for a pose of its handle."""
    moved = system.moved_pattern
    assert moved is not None  # noqa: S101 (a handle that moves a pattern is made where one is moved)
    transforms = system.robot.transforms(pose.joints)
    T_world_parent = compose(system.robot.tree, transforms, system.configuration.world_link, moved.parent_link)[0]
    T_parent_model: Array = inverse(T_world_parent) @ T_world_pattern @ inverse(system.T_model_pattern)
    return T_parent_model


def _nearest_turn(joint: Joint, positions: Array, before: float) -> Array:
    """Shift positions (N,) by full turns to the nearest equivalents of the previous ones within the limits."""
    if joint.kind == "prismatic":
        return positions
    turns = np.round((before - positions) / (2 * np.pi))
    nearest = positions + 2 * np.pi * turns
    inside = (nearest >= joint.lower) & (nearest <= joint.upper)
    return np.where(inside, nearest, positions)
