"""Motion sequences: what is played, one pose after the other.

The file is ATOM's, as its motion recorder writes it: a JSON object with keys "1" to "N", each with
``position`` {x, y, z} and ``orientation`` {x, y, z, w} of the moved pattern's model. For a robot
with joints each has ``joints`` {name: position}, in place of the two or beside them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.dataset.document import Node, read_json
from calibration.dataset.edges import QUATERNION_TOLERANCE
from calibration.geometry import rotations
from calibration.geometry.transforms import from_quaternion
from calibration.geometry.types import Array, IntArray
from calibration.simulation.description import only

MAX_POSES = 10_000
DECIMALS = 6
"""Positions and quaternions are written to a micrometre and a microradian."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A sequence of N poses of a pattern's model, of joints, or of both."""

    positions: Array | None
    """(N, 3): of the moved model, in the frame that the pattern's pose is relative to, m; None if none moves."""
    orientations: Array | None
    """(N, 4): quaternions [x, y, z, w], of length 1 as nearly as they were written."""
    joints: Mapping[str, Array]
    """The positions (N,) of joints, rad or m, by name."""
    source: str = "a generated motion"
    """What messages call it: the file that it was read from."""

    def __len__(self) -> int:
        if self.positions is not None:
            return len(self.positions)
        return len(next(iter(self.joints.values()), ()))

    @property
    def model_poses(self) -> Array | None:
        """(N, 4, 4), or None."""
        if self.positions is None or self.orientations is None:
            return None
        return from_quaternion(self.positions, self.orientations)

    def take(self, index: Sequence[int] | IntArray) -> "Motion":
        """The motion through only the poses of these indices, in this order."""
        index = np.asarray(index, int)
        return replace(
            self,
            positions=None if self.positions is None else self.positions[index],
            orientations=None if self.orientations is None else self.orientations[index],
            joints={name: positions[index] for name, positions in self.joints.items()},
        )


def moving_model(model_poses: Array) -> Motion:
    """The motion of a model through the poses (N, 4, 4), as finely as a file holds it."""
    return Motion(_rounded(model_poses[:, :3, 3]), _rounded(rotations.to_quaternion(model_poses[:, :3, :3])), {})


def moving_joints(joints: Mapping[str, Array]) -> Motion:
    """The motion of joints through positions (N,), as finely as a file holds it."""
    return Motion(None, None, {name: _rounded(positions) for name, positions in joints.items()})


def joined(motions: Sequence[Motion]) -> Motion:
    """One motion through the poses of several, which all move the same."""
    first = motions[0]
    if first.positions is None or first.orientations is None:
        positions = orientations = None
    else:
        positions = np.concatenate([motion.positions for motion in motions if motion.positions is not None])
        orientations = np.concatenate([motion.orientations for motion in motions if motion.orientations is not None])
    joints = {name: np.concatenate([motion.joints[name] for motion in motions]) for name in first.joints}
    return replace(first, positions=positions, orientations=orientations, joints=joints)


def read_motion(path: Path) -> Motion:
    """Read a motion sequence.

    Raises:
        InputError: not JSON, no pose, a gap in the keys, a missing or non-finite number, a
            quaternion of length 0, poses that differ in what they have.
    """
    document = read_json(path)
    count = len(document.mapping())
    if not 1 <= count <= MAX_POSES:
        raise document.fault(f"found {count} poses, expected 1 to {MAX_POSES}")
    keys = [str(number + 1) for number in range(count)]
    missing = next((key for key in keys if key not in document.mapping()), None)
    if missing:
        raise document.fault(f"missing pose '{missing}'; the keys of {count} poses run from '1' to '{count}'")
    poses = [document[key] for key in keys]
    only(poses[0], "position", "orientation", "joints")
    for pose in poses:
        only(pose, *poses[0].mapping())  # every pose has what the first one has
    moves_model = any(key in poses[0].mapping() for key in ("position", "orientation"))
    names = list(poses[0]["joints"].mapping()) if "joints" in poses[0].mapping() else []
    if not moves_model and not names:
        raise poses[0].fault("found neither position and orientation nor joints")
    model = np.array([_read_pose(pose) for pose in poses]) if moves_model else None
    positions = np.array([_read_joints(pose, names) for pose in poses])
    return Motion(
        None if model is None else model[:, :3],
        None if model is None else model[:, 3:],
        dict(zip(names, positions.T, strict=True)),
        str(path),
    )


def _read_pose(pose: Node) -> list[float]:
    position, orientation = pose["position"], pose["orientation"]
    t = [position[axis].number() for axis in "xyz"]
    q = [orientation[axis].number() for axis in "xyzw"]
    length = math.hypot(*q)
    if abs(length - 1) > QUATERNION_TOLERANCE:
        raise orientation.fault(f"found a quaternion of length {length:.6g}, expected length 1")
    return t + q


def _read_joints(pose: Node, names: list[str]) -> list[float]:
    if not names:
        return []
    only(pose["joints"], *names)
    return [pose["joints"][name].number() for name in names]


def motion_document(motion: Motion) -> dict[str, Any]:
    """The JSON document of a motion, which reads back equal."""
    document: dict[str, Any] = {str(i + 1): {} for i in range(len(motion))}
    for i, entry in enumerate(document.values()):
        if motion.positions is not None and motion.orientations is not None:
            entry["position"] = dict(zip("xyz", motion.positions[i].tolist(), strict=True))
            entry["orientation"] = dict(zip("xyzw", motion.orientations[i].tolist(), strict=True))
        if motion.joints:
            entry["joints"] = {name: float(positions[i]) for name, positions in motion.joints.items()}
    return document


def _rounded(values: Array) -> Array:
    finer: Array = np.round(values, DECIMALS) + 0.0  # no negative zeros
    return finer
