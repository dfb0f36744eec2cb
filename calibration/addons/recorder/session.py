"""Editing session of a motion sequence: the current pose, its handle, the saved poses, and the actions on them.

A pose is a motion of length one, with the precision of a file, so that the preview matches what will
be played. Saved poses are immutable and compared by identity. A user drags the handle to set a pose: the moved
pattern, at the centre of its front so that rotations keep it in the field of view, or a frame that joints move.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from calibration.base import InfrastructureError, InputError, read_bytes, write_atomically
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import inverse, translation
from calibration.robot.simulation.kinematics import Placement, joints_between, place, reach, stream
from calibration.robot.simulation.motion import MAX_POSES, POSE_DECIMALS, Motion, motion_document, moving_model
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.scene import MAX_BYTES
from calibration.robot.simulation.system import System
from calibration.robot.urdf import Joint, compose

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


_MAX_UNDO_STEPS = 100  # maximum number of undo steps


class Session:
    """State of the recorder, independent of the page and of threads."""

    def __init__(self, system: System, motion: Motion | None = None) -> None:
        """Start with a sequence, or with no sequence and a pose that the sensors see.

        Raises:
            InputError: nothing in the system moves, or the motion does not match it.
        """
        self.system = system
        self.handle = find_handle(system)
        if self.handle is None and not system.robot.movable:
            raise InputError(
                f"{system.name}: found no pattern that is moved and no joint that moves; nothing to record"
            )
        self.poses: tuple[Motion, ...] = ()
        """Saved poses, in the order in which they are played."""
        self.selected: int | None = None
        """Index of the saved pose that was last saved or selected."""
        self._written: tuple[Motion, ...] = ()
        self._files: dict[Path, bytes] = {}  # files that this session wrote
        self._history: list[tuple[tuple[Motion, ...], int | None]] = []
        if motion is None:
            self.pose = _first_pose(system)
        else:
            self.load(motion)
            self._written = self.poses
            self._history.clear()

    # The current pose

    @property
    def placement(self) -> Placement:
        """Placement of the system at the current pose; its arrays are (1, 4, 4)."""
        return place(self.system, self.pose)

    @property
    def is_changed(self) -> bool:
        """Whether the current pose differs from the selected one."""
        return self.selected is not None and self.pose is not self.poses[self.selected]

    def handle_pose(self) -> Array | None:
        """Return ``T_world_handle`` (4, 4); None if the system has no handle."""
        return None if self.handle is None else handle_pose(self.system, self.handle, self.pose)

    def drag(self, T_world_handle: Array) -> bool:
        """Move the handle; return False, with the pose unchanged, if it cannot be reached."""
        pose = None if self.handle is None else drag(self.system, self.handle, self.pose, T_world_handle)
        if pose is not None:
            self.pose = settled(self.system, pose)
        return pose is not None

    def move_model(self, T_parent_model: Array) -> None:
        """Move the model of the moved pattern to a pose (4, 4) in its parent frame."""
        moved = moving_model(T_parent_model[None])
        self.pose = replace(self.pose, positions=moved.positions, orientations=moved.orientations)

    def move_joints(self, positions: Mapping[str, float]) -> None:
        """Move joints, rad or m, within their limits."""
        joints = {name: np.array([position]) for name, position in positions.items()}
        self.pose = settled(self.system, replace(self.pose, joints={**self.pose.joints, **joints}))

    # The sequence

    def save(self) -> None:
        """Append the current pose to the sequence.

        Raises:
            InputError: there are already `MAX_POSES`.
        """
        if len(self.poses) >= MAX_POSES:
            raise InputError(f"found {len(self.poses)} poses; a sequence has {MAX_POSES} at most")
        self.pose = replace(self.pose)  # a copy, because saved poses are compared by identity
        self._change_poses((*self.poses, self.pose), len(self.poses))

    def replace_selected(self) -> None:
        """Replace the selected pose by the current one."""
        if self.selected is not None and self.is_changed:
            self._change_poses(
                (*self.poses[: self.selected], self.pose, *self.poses[self.selected + 1 :]), self.selected
            )

    def delete_selected(self) -> None:
        """Delete the selected pose; the next one is selected, and becomes the current pose."""
        if self.selected is None:
            return
        left = self.poses[: self.selected] + self.poses[self.selected + 1 :]
        self._change_poses(left, min(self.selected, len(left) - 1) if left else None)
        if self.selected is not None:
            self.pose = self.poses[self.selected]

    def shift_selected(self, steps: int) -> None:
        """Move the selected pose by a number of positions (negative: earlier), limited to the ends."""
        if self.selected is None:
            return
        target = min(max(self.selected + steps, 0), len(self.poses) - 1)
        others = [*self.poses[: self.selected], *self.poses[self.selected + 1 :]]
        others.insert(target, self.poses[self.selected])
        if target != self.selected:
            self._change_poses(tuple(others), target)

    def select(self, index: int) -> None:
        """Make a saved pose the current pose.

        Raises:
            IndexError: there is no pose with this index.
        """
        if not 0 <= index < len(self.poses):
            raise IndexError(index)
        self.selected, self.pose = index, self.poses[index]

    @property
    def can_undo(self) -> bool:
        """Whether a change of the sequence can be undone."""
        return bool(self._history)

    def undo(self) -> None:
        """Undo the last change of the sequence."""
        if self._history:
            self.poses, self.selected = self._history.pop()
            if self.selected is not None:
                self.pose = self.poses[self.selected]

    def load(self, motion: Motion) -> None:
        """Replace the whole sequence; its first pose becomes the current one.

        Raises:
            InputError: it does not match the system; nothing is changed.
        """
        place(self.system, motion)
        rest = {name: np.full(len(motion), joint.rest) for name, joint in self.system.robot.movable.items()}
        whole = replace(motion, joints={**rest, **motion.joints})
        poses = tuple(whole.take([i]) for i in range(len(whole)))
        self._change_poses(poses, 0)
        self.pose = poses[0]

    def _change_poses(self, poses: tuple[Motion, ...], selected: int | None) -> None:
        self._history = [*self._history, (self.poses, self.selected)][-_MAX_UNDO_STEPS:]
        self.poses, self.selected = poses, selected

    # Files

    @property
    def is_unsaved(self) -> bool:
        """Whether there are poses that are not in a file."""
        return bool(self.poses) and self.poses != self._written

    def motion(self) -> Motion:
        """Return the saved poses as one motion.

        Raises:
            InputError: no pose is saved.
        """
        if not self.poses:
            raise InputError("no pose is saved yet; a sequence needs one at least")
        return joined(self.poses)

    def text(self) -> str:
        """Return the sequence in the format of a file.

        Raises:
            InputError: no pose is saved.
        """
        return json.dumps(motion_document(self.motion()), indent=2, sort_keys=True) + "\n"

    def export(self, path: Path, replace_file: bool = False) -> None:
        """Write the sequence to a file.

        Raises:
            InputError: no pose is saved, or the file exists, is not what this session wrote there,
                and may not be replaced.
            InfrastructureError: it cannot be written.
        """
        content = self.text().encode()
        if not replace_file and not self.may_write(path):
            raise InputError(f"{path}: exists already; replace it, or give another name")
        write_atomically(path, content)
        self._files[path] = content
        self._written = self.poses

    def autosave(self, output: Path) -> Path | None:
        """Write unsaved poses to a new file beside the export file, or in the temporary folder.

        Returns:
            The new file; None if everything is saved.

        Raises:
            InfrastructureError: no location is writable.
        """
        if not self.is_unsaved:
            return None
        try:
            path = _free_name(output)
            self.export(path)
        except InfrastructureError:
            path = _free_name(Path(tempfile.gettempdir(), output.name))
            self.export(path)
        return path

    def may_write(self, path: Path) -> bool:
        """Return whether a file can be overwritten without loss: it is missing, or as this session wrote it."""
        own = self._files.get(path)
        is_there = path.exists() or path.is_symlink()
        return not is_there or (own is not None and read_bytes(path, MAX_BYTES, "a motion sequence") == own)


def _free_name(output: Path) -> Path:
    """Return an unused file name for unsaved poses, beside a file."""
    numbers = chain([""], (f"-{number}" for number in count(2)))
    return next(
        path for number in numbers if not (path := output.with_name(f"{output.stem}.autosave{number}.json")).exists()
    )


def settled(system: System, pose: Motion) -> Motion:
    """Round a pose to the precision of a file, with its joints within their limits."""
    joints = {}
    for name, joint in system.robot.movable.items():
        rounded = np.round(pose.joints.get(name, np.array([joint.rest])), POSE_DECIMALS) + 0.0
        joints[name] = np.clip(rounded, joint.lower, joint.upper)
    return replace(pose, joints=joints)


def joined(poses: Sequence[Motion]) -> Motion:
    """Join poses with the same joints and models to one motion."""
    positions = [pose.positions for pose in poses if pose.positions is not None]
    orientations = [pose.orientations for pose in poses if pose.orientations is not None]
    return Motion(
        np.concatenate(positions) if positions else None,
        np.concatenate(orientations) if orientations else None,
        {name: np.concatenate([pose.joints[name] for pose in poses]) for name in poses[0].joints},
        "the recorded motion",
    )


def _first_pose(system: System) -> Motion:
    """Return a pose that every sensor sees, if one is found; else a default in front of a sensor."""
    moved = system.moved_pattern
    rest = {name: np.array([joint.rest]) for name, joint in system.robot.movable.items()}
    try:
        pose = generate_motion(system, 1, seed=1)
    except InputError:
        pose = moving_model(_in_front(system)) if moved is not None else Motion(None, None, {})
    return settled(system, replace(pose, joints={**rest, **pose.joints}, source="the recorded motion"))


def _in_front(system: System) -> Array:
    """Return ``T_parent_model`` (1, 4, 4) of the moved pattern, facing the first sensor at two metres."""
    moved = system.moved_pattern
    assert moved is not None  # noqa: S101 (the caller has asked)
    sensor = next(iter(system.configuration.sensors.values()))
    transforms = system.robot.transforms({})
    T_parent_sensor = compose(system.robot.tree, transforms, moved.parent_link, sensor.link)
    T_sensor_pattern = np.eye(4)
    T_sensor_pattern[:3, 3] = np.array([0.0, 0.0, 2.0]) - moved.centre
    return T_parent_sensor @ T_sensor_pattern @ inverse(system.T_model_pattern)
