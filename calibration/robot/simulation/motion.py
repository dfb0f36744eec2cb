"""Motion sequences: poses that are played one after the other.

The file format is that of ATOM's motion recorder: a JSON object with keys "1" to "N", each with a `Pose`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.base.records import Misfit, Place, field, length, matching, needs, read_as, record, unknown_key
from calibration.engine.dataset.document import read_json
from calibration.engine.dataset.edges import QUATERNION_TOLERANCE
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import from_quaternion

MAX_POSES = 10_000
GENERATED_PREFIX = "generate:"
"""Prefix of the name of a generated motion: ``generate:22`` has 22 poses."""
MAX_GENERATED = 1000
"""Limit of the poses of a generated motion."""
POSE_DECIMALS = 6
"""Decimals of positions and quaternions: a micrometre and a microradian."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A sequence of N poses of a pattern's model, of joints, or of both."""

    positions: Array | None
    """(N, 3): position of the moved model, m, in the frame that the pattern's pose is relative to; None without one."""
    orientations: Array | None
    """(N, 4): quaternions [x, y, z, w], of norm 1 up to rounding."""
    joints: Mapping[str, Array]
    """Positions (N,) of joints, rad or m, by name."""
    source: str = "a generated motion"
    """Name in messages: the file that it was read from."""

    def __len__(self) -> int:
        if self.positions is not None:
            return len(self.positions)
        return len(next(iter(self.joints.values()), ()))

    @property
    def model_poses(self) -> Array | None:
        """Poses of the moved model (N, 4, 4), or None."""
        if self.positions is None or self.orientations is None:
            return None
        return from_quaternion(self.positions, self.orientations)

    def take(self, index: Sequence[int] | IntArray) -> "Motion":
        """Return the motion through only the poses of these indices, in this order."""
        index = np.asarray(index, int)
        return replace(
            self,
            positions=None if self.positions is None else self.positions[index],
            orientations=None if self.orientations is None else self.orientations[index],
            joints={name: positions[index] for name, positions in self.joints.items()},
        )


def moving_model(model_poses: Array) -> Motion:
    """Return the motion of a model through the poses (N, 4, 4), rounded as in a file."""
    return Motion(
        _round_numbers(model_poses[:, :3, 3]), _round_numbers(rotations.to_quaternion(model_poses[:, :3, :3])), {}
    )


def moving_joints(joints: Mapping[str, Array]) -> Motion:
    """Return the motion of joints through positions (N,), rounded as in a file."""
    return Motion(None, None, {name: _round_numbers(positions) for name, positions in joints.items()})


def joined(motions: Sequence[Motion]) -> Motion:
    """Concatenate motions, which all move the same."""
    first = motions[0]
    if first.positions is None or first.orientations is None:
        positions = orientations = None
    else:
        positions = np.concatenate([motion.positions for motion in motions if motion.positions is not None])
        orientations = np.concatenate([motion.orientations for motion in motions if motion.orientations is not None])
    joints = {name: np.concatenate([motion.joints[name] for motion in motions]) for name in first.joints}
    return replace(first, positions=positions, orientations=orientations, joints=joints)


@record
class Position:
    """Position of the moved model, in the frame that the pattern's pose is relative to, m."""

    x: float = field("Along x, m.")
    y: float = field("Along y, m.")
    z: float = field("Along z, m.")


@record
class Orientation:
    """Unit quaternion."""

    x: float = field("Of the axis of the turn, times the sine of half its angle.")
    y: float = field("Of the axis of the turn, times the sine of half its angle.")
    z: float = field("Of the axis of the turn, times the sine of half its angle.")
    w: float = field("Cosine of half the angle.")

    def __post_init__(self) -> None:
        """Check the norm."""
        length = math.hypot(self.x, self.y, self.z, self.w)
        if abs(length - 1) > QUATERNION_TOLERANCE:
            raise Misfit(f"found a quaternion of length {length:.6g}, expected length 1")


@record(
    rules=(
        needs("position", "orientation", "missing key 'orientation'"),
        needs("orientation", "position", "missing key 'position'"),
    )
)
class Pose:
    """A pose of a motion: of the moved model, of joints, or of both."""

    position: Position | None = field("Position of the moved model.", default=None)
    orientation: Orientation | None = field("Orientation of the moved model.", default=None)
    joints: Mapping[str, float] = field("Positions of joints, rad or m.", default_factory=dict)

    def __post_init__(self) -> None:
        """Check that something moves."""
        if self.position is None and not self.joints:
            raise Misfit("found neither position and orientation nor joints")

    @property
    def model(self) -> list[float] | None:
        """Position and quaternion [x, y, z, x, y, z, w] of the moved model; None if none moves."""
        if (p := self.position) is None or (q := self.orientation) is None:
            return None
        return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


MotionFile = Annotated[
    Mapping[Annotated[str, matching("[1-9][0-9]*", "the number of a pose")], Pose], length(1, MAX_POSES)
]
"""Content of a motion file; every pose has the same keys as the first one."""


def read_motion(path: Path) -> Motion:
    """Read a motion sequence.

    Raises:
        InputError: not JSON, no pose, a gap in the keys, a missing or non-finite number, a
            quaternion of length 0, poses with different keys.
    """
    place, document = Place(str(path)), read_json(path).mapping()
    count = len(document)
    if not 1 <= count <= MAX_POSES:
        raise place.fault(f"found {count} poses, expected 1 to {MAX_POSES}")
    keys = [str(number + 1) for number in range(count)]
    if missing := next((key for key in keys if key not in document), None):
        raise place.fault(f"missing pose '{missing}'; the keys of {count} poses run from '1' to '{count}'")
    poses: list[Pose] = [read_as(Pose, document[key], place.below(key)) for key in keys]
    for key, pose in zip(keys, poses, strict=True):
        _check_same(poses[0], pose, place.below(key))
    models = [pose.model for pose in poses]
    model = None if models[0] is None else np.array(models)
    return Motion(
        None if model is None else model[:, :3],
        None if model is None else model[:, 3:],
        {name: np.array([pose.joints[name] for pose in poses]) for name in poses[0].joints},
        str(path),
    )


def _check_same(first: Pose, pose: Pose, place: Place) -> None:
    """Check that a pose has the same keys as the first one."""
    if (pose.position is None) != (first.position is None):
        with_it, without = ("1", place.keys[-1]) if pose.position is None else (place.keys[-1], "1")
        raise place.fault(f"every pose has what the first one has: '{with_it}' has a position, '{without}' has none")
    for name in first.joints:
        if name not in pose.joints:
            raise place.below("joints").fault(f"missing key '{name}'")
    for name in pose.joints:
        if name not in first.joints:
            raise place.below("joints").fault(unknown_key(name, first.joints))


def pose_count(motion: str) -> int:
    """Return the number of poses of a generated motion: N of ``generate:N``.

    Raises:
        InputError: it is not a number from 1 to `MAX_GENERATED`.
    """
    count = motion.removeprefix(GENERATED_PREFIX)
    if not (count.isascii() and count.isdigit() and len(count) < 10 and 1 <= int(count) <= MAX_GENERATED):
        raise InputError(f"motion: found '{motion}', expected {GENERATED_PREFIX}N with N from 1 to {MAX_GENERATED}")
    return int(count)


def motion_document(motion: Motion) -> dict[str, Any]:
    """Return the JSON document of a motion, which reads back equal."""
    document: dict[str, Any] = {str(i + 1): {} for i in range(len(motion))}
    for i, entry in enumerate(document.values()):
        if motion.positions is not None and motion.orientations is not None:
            entry["position"] = dict(zip("xyz", motion.positions[i].tolist(), strict=True))
            entry["orientation"] = dict(zip("xyzw", motion.orientations[i].tolist(), strict=True))
        if motion.joints:
            entry["joints"] = {name: float(positions[i]) for name, positions in motion.joints.items()}
    return document


def _round_numbers(values: Array) -> Array:
    return np.round(values, POSE_DECIMALS) + 0.0  # no negative zeros


PLAYER_FILE = Path(__file__).parent / "ros1_player.py"
"""Player that moves the pattern in a team's own simulation: a single file, which runs in the team's image, without this
package; it requests the robot to save each pose."""


def check_motion(motion: Motion) -> None:
    """Check that a player can play a motion, which it reads from the file of `motion_document`.

    Raises:
        InputError: it moves joints, or nothing: a player only moves a free pattern.
    """
    if motion.joints:
        joints = ", ".join(list(motion.joints)[:3])
        raise InputError(
            f"{motion.source}: moves joints ({joints}), but our player moves a free pattern only; "
            "leave out player and let one of the containers play"
        )
    if not len(motion):
        raise InputError(f"{motion.source}: found no pose, expected one at least")
