"""What a user takes hold of to make a pose: the moved pattern, or what the robot's joints move.

The handle of a pattern sits on the middle of its front, not on the origin of its frame, so that
turning it leaves it where the sensors look.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.geometry.transforms import inverse, translation
from calibration.geometry.types import Array
from calibration.simulation.inverse_kinematics import joints_between, reach
from calibration.simulation.motion.sequence import Motion, moving_model
from calibration.simulation.placement import place
from calibration.simulation.random_streams import stream
from calibration.simulation.robot import Joint, compose
from calibration.simulation.system import System

_STARTS = 64
"""Searches for joint positions: enough that the nearest of an arm's solutions is nearly always among those found."""


@dataclass(frozen=True, eq=False)
class Handle:
    """A frame that a user drags and turns."""

    frame: str
    """The link that it is fixed to; a moved pattern's is in no robot."""
    T_frame_handle: Array
    """(4, 4)."""
    moves_pattern: bool
    """Whether it moves a pattern that stands free; else joints follow it."""


def find_handle(system: System) -> Handle | None:
    """The moved pattern; else the first pattern, else the first sensor, that joints move; None where nothing moves."""
    moved = system.moved_pattern
    if moved is not None:
        return Handle(moved.link, _middle(system, moved.name), moves_pattern=True)
    frames = {pattern.link: _middle(system, name) for name, pattern in system.patterns.items()}
    frames |= {sensor.link: np.eye(4) for sensor in system.configuration.sensors.values()}
    for frame, T_frame_handle in frames.items():
        if joints_between(system.robot, system.configuration.world_link, frame):
            return Handle(frame, T_frame_handle, moves_pattern=False)
    return None


def handle_pose(system: System, handle: Handle, pose: Motion) -> Array:
    """``T_world_handle`` (4, 4) at a pose, which is a motion of one."""
    placement = place(system, pose)
    if handle.moves_pattern:
        moved = next(name for name, pattern in system.patterns.items() if pattern.link == handle.frame)
        T_world_frame = placement.patterns[moved]
    else:
        T_world_frame = compose(system.robot.tree, placement.transforms, system.configuration.world_link, handle.frame)
    T_world_handle: Array = T_world_frame[0] @ handle.T_frame_handle
    return T_world_handle


def drag(system: System, handle: Handle, pose: Motion, T_world_handle: Array) -> Motion | None:
    """The pose that puts the handle there, the nearest to what it was; None where no joint positions do."""
    T_world_frame = T_world_handle @ inverse(handle.T_frame_handle)
    if handle.moves_pattern:
        moved = moving_model(_model_pose(system, pose, T_world_frame)[None])
        return replace(pose, positions=moved.positions, orientations=moved.orientations)
    world = system.configuration.world_link
    joints = joints_between(system.robot, world, handle.frame)
    targets = np.broadcast_to(T_world_frame, (_STARTS, 4, 4))
    positions, reached = reach(system.robot, world, handle.frame, targets, stream(1, "handle"))
    if not reached.any():
        return None
    before = {joint.name: float(pose.joints[joint.name][0]) for joint in joints}
    found = {joint.name: _nearest_turn(joint, positions[joint.name][reached], before[joint.name]) for joint in joints}
    way = sum(np.abs(found[name] - before[name]) for name in found)
    nearest = int(np.argmin(way))
    return replace(pose, joints={**pose.joints, **{name: values[[nearest]] for name, values in found.items()}})


def _middle(system: System, pattern: str) -> Array:
    """``T_pattern_handle``."""
    x, y = system.patterns[pattern].outline.mean(axis=0)
    return translation(np.array([x, y, 0.0]))


def _model_pose(system: System, pose: Motion, T_world_pattern: Array) -> Array:
    """``T_parent_model`` (4, 4) of the moved pattern that stands there."""
    moved = system.moved_pattern
    assert moved is not None  # noqa: S101 (a handle that moves a pattern is made where one is moved)
    transforms = system.robot.transforms(pose.joints)
    T_world_parent = compose(system.robot.tree, transforms, system.configuration.world_link, moved.parent_link)[0]
    T_parent_model: Array = inverse(T_world_parent) @ T_world_pattern @ inverse(system.T_model_pattern)
    return T_parent_model


def _nearest_turn(joint: Joint, positions: Array, before: float) -> Array:
    """The positions (N,), each by whole turns as near to the one before as the limits allow."""
    if joint.kind == "prismatic":
        return positions
    turns = np.round((before - positions) / (2 * np.pi))
    nearest = positions + 2 * np.pi * turns
    inside = (nearest >= joint.lower) & (nearest <= joint.upper)
    return np.where(inside, nearest, positions)
