"""A motion sequence in the making: the pose at hand, the poses saved so far, and what can be done with them.

A pose is a motion of one pose, as finely as a file holds it, so that what is looked at is what will
be played. Saved poses are never changed, only replaced: each is one object as long as it is there.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from calibration.dataset.json_text import json_text
from calibration.errors import InputError, WorldError
from calibration.files import read_bytes, write_atomically
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array
from calibration.recorder.handle import drag, find_handle, handle_pose
from calibration.simulation.description import MAX_BYTES
from calibration.simulation.motion.generation import generate_motion
from calibration.simulation.motion.sequence import DECIMALS, MAX_POSES, Motion, motion_document, moving_model
from calibration.simulation.placement import Placement, place
from calibration.simulation.robot import compose
from calibration.simulation.system import System

_UNDONE = 100  # steps back


class Session:
    """What a user of the recorder works on. It knows no page, and no threads."""

    def __init__(self, system: System, motion: Motion | None = None) -> None:
        """Begin with a sequence, or with none and a pose that the sensors see.

        Raises:
            InputError: nothing in the system moves, or the motion does not fit it.
        """
        self.system = system
        self.handle = find_handle(system)
        if self.handle is None and not system.robot.movable:
            raise InputError(
                f"{system.name}: found no pattern that is moved and no joint that moves; nothing to record"
            )
        self.poses: tuple[Motion, ...] = ()
        """The saved ones, in the order in which they are played."""
        self.selected: int | None = None
        """The index of the saved pose that was last saved or chosen."""
        self._written: tuple[Motion, ...] = ()
        self._files: dict[Path, bytes] = {}  # what this session wrote
        self._history: list[tuple[tuple[Motion, ...], int | None]] = []
        if motion is None:
            self.pose = _first_pose(system)
        else:
            self.load(motion)
            self._written = self.poses
            self._history.clear()

    # The pose at hand

    @property
    def placement(self) -> Placement:
        """Where everything stands at the pose at hand; its arrays are (1, 4, 4)."""
        return place(self.system, self.pose)

    @property
    def is_changed(self) -> bool:
        """Whether the pose at hand is another than the selected one."""
        return self.selected is not None and self.pose is not self.poses[self.selected]

    def handle_pose(self) -> Array | None:
        """``T_world_handle`` (4, 4); None where there is nothing to take hold of."""
        return None if self.handle is None else handle_pose(self.system, self.handle, self.pose)

    def drag(self, T_world_handle: Array) -> bool:
        """Move the handle; whether it could go there. If not, the pose stays as it is."""
        pose = None if self.handle is None else drag(self.system, self.handle, self.pose, T_world_handle)
        if pose is not None:
            self.pose = settled(self.system, pose)
        return pose is not None

    def move_model(self, T_parent_model: Array) -> None:
        """Move the model of the moved pattern to a pose (4, 4) in its parent frame."""
        moved = moving_model(T_parent_model[None])
        self.pose = replace(self.pose, positions=moved.positions, orientations=moved.orientations)

    def move_joints(self, positions: Mapping[str, float]) -> None:
        """Move joints, rad or m; no further than their limits."""
        joints = {name: np.array([position]) for name, position in positions.items()}
        self.pose = settled(self.system, replace(self.pose, joints={**self.pose.joints, **joints}))

    # The sequence

    def save(self) -> None:
        """Add the pose at hand to the end.

        Raises:
            InputError: there are `MAX_POSES` already.
        """
        if len(self.poses) >= MAX_POSES:
            raise InputError(f"found {len(self.poses)} poses; a sequence has {MAX_POSES} at most")
        self.pose = replace(self.pose)  # an object of its own, even where it is saved twice
        self._change((*self.poses, self.pose), len(self.poses))

    def replace_selected(self) -> None:
        """Put the pose at hand in the place of the selected one."""
        if self.selected is not None and self.is_changed:
            self._change((*self.poses[: self.selected], self.pose, *self.poses[self.selected + 1 :]), self.selected)

    def delete_selected(self) -> None:
        """Take the selected pose out; the next one is selected, and is the pose at hand."""
        if self.selected is None:
            return
        left = self.poses[: self.selected] + self.poses[self.selected + 1 :]
        self._change(left, min(self.selected, len(left) - 1) if left else None)
        if self.selected is not None:
            self.pose = self.poses[self.selected]

    def shift_selected(self, steps: int) -> None:
        """Move the selected pose so many places later (negative: earlier), as far as there are places."""
        if self.selected is None:
            return
        target = min(max(self.selected + steps, 0), len(self.poses) - 1)
        others = [*self.poses[: self.selected], *self.poses[self.selected + 1 :]]
        others.insert(target, self.poses[self.selected])
        if target != self.selected:
            self._change(tuple(others), target)

    def select(self, index: int) -> None:
        """Make a saved pose the pose at hand.

        Raises:
            IndexError: there is none of this index.
        """
        if not 0 <= index < len(self.poses):
            raise IndexError(index)
        self.selected, self.pose = index, self.poses[index]

    @property
    def can_undo(self) -> bool:
        """Whether a change of the sequence can be taken back."""
        return bool(self._history)

    def undo(self) -> None:
        """Take the last change of the sequence back."""
        if self._history:
            self.poses, self.selected = self._history.pop()
            if self.selected is not None:
                self.pose = self.poses[self.selected]

    def load(self, motion: Motion) -> None:
        """Take a whole sequence in place of the one there is; the first pose is the pose at hand.

        Raises:
            InputError: it does not fit the system; nothing is changed.
        """
        place(self.system, motion)
        rest = {name: np.full(len(motion), joint.rest) for name, joint in self.system.robot.movable.items()}
        whole = replace(motion, joints={**rest, **motion.joints})
        poses = tuple(whole.take([i]) for i in range(len(whole)))
        self._change(poses, 0)
        self.pose = poses[0]

    def _change(self, poses: tuple[Motion, ...], selected: int | None) -> None:
        self._history = [*self._history, (self.poses, self.selected)][-_UNDONE:]
        self.poses, self.selected = poses, selected

    # Files

    @property
    def is_unsaved(self) -> bool:
        """Whether there are poses that no file has."""
        return bool(self.poses) and self.poses != self._written

    def motion(self) -> Motion:
        """The saved poses as one motion.

        Raises:
            InputError: there is none.
        """
        if not self.poses:
            raise InputError("no pose is saved yet; a sequence needs one at least")
        return joined(self.poses)

    def text(self) -> str:
        """The sequence as a file has it.

        Raises:
            InputError: no pose is saved.
        """
        return json_text(motion_document(self.motion())) + "\n"

    def export(self, path: Path, replace_file: bool = False) -> None:
        """Write the sequence to a file.

        Raises:
            InputError: no pose is saved, or the file exists, is not what this session wrote there,
                and may not be replaced.
            WorldError: it cannot be written.
        """
        content = self.text().encode()
        if not replace_file and not self.may_write(path):
            raise InputError(f"{path}: exists already; replace it, or give another name")
        write_atomically(path, content)
        self._files[path] = content
        self._written = self.poses

    def autosave(self, output: Path) -> Path | None:
        """Write what no file has yet beside the file that it would be exported to, or among temporary files.

        Returns:
            The new file; None where a file has everything.

        Raises:
            WorldError: it can be written nowhere.
        """
        if not self.is_unsaved:
            return None
        try:
            path = _free_name(output)
            self.export(path)
        except WorldError:
            path = _free_name(Path(tempfile.gettempdir(), output.name))
            self.export(path)
        return path

    def may_write(self, path: Path) -> bool:
        """Whether writing a file loses nobody's work: there is none, or it is as this session wrote it."""
        own = self._files.get(path)
        return not path.exists() or (own is not None and read_bytes(path, MAX_BYTES, "a motion sequence") == own)


def _free_name(output: Path) -> Path:
    """A name beside a file, for what was not exported, that no file has."""
    numbers = chain([""], (f"-{number}" for number in count(2)))
    return next(
        path for number in numbers if not (path := output.with_name(f"{output.stem}.autosave{number}.json")).exists()
    )


def settled(system: System, pose: Motion) -> Motion:
    """A pose as finely as a file holds it, with its joints inside their limits."""
    joints = {}
    for name, joint in system.robot.movable.items():
        rounded = np.round(pose.joints.get(name, np.array([joint.rest])), DECIMALS) + 0.0
        joints[name] = np.clip(rounded, joint.lower, joint.upper)
    return replace(pose, joints=joints)


def joined(poses: Sequence[Motion]) -> Motion:
    """One motion through poses that are alike in what they have."""
    positions = [pose.positions for pose in poses if pose.positions is not None]
    orientations = [pose.orientations for pose in poses if pose.orientations is not None]
    return Motion(
        np.concatenate(positions) if positions else None,
        np.concatenate(orientations) if orientations else None,
        {name: np.concatenate([pose.joints[name] for pose in poses]) for name in poses[0].joints},
        "the recorded motion",
    )


def _first_pose(system: System) -> Motion:
    """One that every sensor sees, if it can be found; else the joints at rest and the pattern in front of a sensor."""
    moved = system.moved_pattern
    rest = {name: np.array([joint.rest]) for name, joint in system.robot.movable.items()}
    try:
        pose = generate_motion(system, 1, seed=1)
    except InputError:
        pose = moving_model(_in_front(system)) if moved is not None else Motion(None, None, {})
    return settled(system, replace(pose, joints={**rest, **pose.joints}, source="the recorded motion"))


def _in_front(system: System) -> Array:
    """``T_parent_model`` (1, 4, 4) of the moved pattern, facing the first sensor from two metres away."""
    moved = system.moved_pattern
    assert moved is not None  # noqa: S101 (the caller has asked)
    sensor = next(iter(system.configuration.sensors.values()))
    transforms = system.robot.transforms({})
    T_parent_sensor = compose(system.robot.tree, transforms, moved.parent_link, sensor.link)
    T_sensor_pattern = np.eye(4)
    T_sensor_pattern[:3, 3] = np.array([0.0, 0.0, 2.0]) - moved.centre
    return T_parent_sensor @ T_sensor_pattern @ inverse(system.T_model_pattern)
