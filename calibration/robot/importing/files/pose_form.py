"""How the poses of a file are written, ``rotation``, ``degrees``, ``units``, ``inverse``: one record of conventions."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.records import Converted, Place, excludes, field, length, record
from calibration.engine.dataset.edges import MAX_FRAME_DISTANCE_M, QUATERNION_TOLERANCE
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, transform

Name = Annotated[str, length(1, 200)]
METRES_OF_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Metres in a unit."""
MAX_ORTHOGONALITY_ERROR = 1e-3
"""Tolerance of a rotation matrix's orthogonality; it is projected to a rotation."""
MAX_RADIANS = 2 * np.pi + 0.01
"""rad: limit of an angle, beyond which it is in degrees."""
MAX_DEGREES = 720.0
QUATERNION_CONVENTIONS = ("quaternion-xyzw", "quaternion-wxyz")
_EULER_CONVENTION = re.compile(r"euler-([xyz])([xyz])([xyz])-(extrinsic|intrinsic)")
_EULER_WITHOUT_FRAME = re.compile(r"euler-[xyz]{3}")
_EXPECTED_CONVENTIONS = (
    "quaternion-xyzw, quaternion-wxyz, rotvec, matrix, euler-xyz-extrinsic (roll, pitch, yaw about fixed axes) or "
    "euler-zyx-intrinsic (about moving axes), of any axes"
)


def _rotation_convention(text: str, place: Place) -> str:
    """Return the name of a convention, or raise InputError."""
    text = {"xyzw": QUATERNION_CONVENTIONS[0], "wxyz": QUATERNION_CONVENTIONS[1]}.get(text, text)
    found = _EULER_CONVENTION.fullmatch(text)
    if text in (*QUATERNION_CONVENTIONS, "rotvec", "matrix") or (found and found[1] != found[2] != found[3]):
        return text
    if _EULER_WITHOUT_FRAME.fullmatch(text):
        raise place.unexpected(
            text,
            f"{text}-extrinsic (one after the other about the fixed axes) or {text}-intrinsic (about the axes that "
            "have turned along)",
        )
    raise place.unexpected(text, _EXPECTED_CONVENTIONS)


Rotation = Annotated[str, Converted(Name, _rotation_convention)]


@record(rules=(excludes("columns", "key"),))
class PoseForm:
    """How poses are written in a file of another tool."""

    key: Name | None = field(
        "What the poses are called there, where that has more: a key (O_T_EE), the begin of numbered ones (T1_), of "
        "columns (tool_), or the first word of their rows (hand).",
        default=None,
    )
    columns: Annotated[tuple[Name, ...], length(1, 1000)] | None = field(
        "What the columns are, in their order, where the table does not say it in these words: image, x, y, z, qx, "
        "qy, qz, qw (or rx, ry, rz; r11 to r33), pattern_x ...; '-' for one that is left out.",
        default=None,
    )
    rotation: Rotation | None = field(
        f"How rotations are written: {_EXPECTED_CONVENTIONS} (quaternion-xyzw, or matrix, as their numbers are).",
        default=None,
    )
    degrees: bool | None = field("Whether angles are in degrees (false: radians).", default=None)
    units: Literal["m", "cm", "mm", "in"] | None = field("Unit of the translations (m).", default=None)
    inverse: bool = field(
        "Whether they are the other way round: of the base in the tool's frame; of the camera in the pattern's.",
        default=False,
    )

    def inherited(self, other: "PoseForm") -> "PoseForm":
        """Return this form with the rotation, degrees and units of another one where it has none."""
        return PoseForm(
            key=self.key,
            columns=self.columns,
            rotation=self.rotation or other.rotation,
            degrees=other.degrees if self.degrees is None else self.degrees,
            units=self.units or other.units,
            inverse=self.inverse,
        )

    def pose(self, t: Sequence[float], numbers: Sequence[float], where: str) -> Array:
        """Return the pose (4, 4) of a translation and the numbers of a rotation.

        Args:
            t: (3,), in `units`.
            numbers: of the rotation: 4 of a quaternion, 3 of angles or of a vector, 9 of a matrix by its rows.
            where: place in the file, for messages.

        Raises:
            InputError: they are no pose of this form.
        """
        scaled = METRES_OF_UNIT[self.units or "m"] * np.array(t, float)
        if not (np.abs(scaled) <= MAX_FRAME_DISTANCE_M).all():
            raise InputError(
                f"{where}: found a translation of {t}, expected numbers of at most {MAX_FRAME_DISTANCE_M:g} m"
            )
        T = transform(self._rotation_convention(numbers, where), scaled)
        return inverse(T) if self.inverse else T

    def _rotation_convention(self, numbers: Sequence[float], where: str) -> Array:
        named, count = self.rotation, len(numbers)
        named = named or {4: QUATERNION_CONVENTIONS[0], 9: "matrix"}.get(count)
        if named is None:
            raise InputError(
                f"{where}: found {count} numbers of a rotation, which may be angles or a vector: add 'rotation' to "
                "'samples' in import.yml: rotvec, euler-xyz-extrinsic or euler-zyx-intrinsic, ..."
            )
        expected = 4 if named in QUATERNION_CONVENTIONS else 9 if named == "matrix" else 3
        if count != expected:
            raise InputError(f"{where}: found {count} numbers of a rotation, expected the {expected} of {named}")
        values = np.array(numbers, float)
        if expected == 4:
            return _of_quaternion(values if named == QUATERNION_CONVENTIONS[0] else np.roll(values, -1), where)
        if expected == 9:
            return _of_matrix(values.reshape(3, 3), where)
        return self._of_angles(named, values, where)

    def _of_angles(self, named: str, values: Array, where: str) -> Array:
        """Return the rotation (3, 3) of Euler angles or of a rotation vector."""
        limit = MAX_DEGREES if self.degrees else MAX_RADIANS
        if (far := float(np.abs(values).max())) > limit:
            raise InputError(
                f"{where}: found an angle of {far:g}, expected {limit:.4g} at most"
                + ("" if self.degrees else ": add 'degrees: true' to 'samples' in import.yml if it is in degrees")
            )
        radians = np.radians(values) if self.degrees else values
        if (euler := _EULER_CONVENTION.fullmatch(named)) is None:
            return rotations.exp(radians)
        parts = [rotations.exp(angle * np.eye(3)["xyz".index(euler[i + 1])]) for i, angle in enumerate(radians)]
        if euler[4] == "extrinsic":
            parts.reverse()
        return parts[0] @ parts[1] @ parts[2]


def _of_quaternion(q: Array, where: str) -> Array:
    if not abs((norm := math.hypot(*q)) - 1) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: found a quaternion of length {norm:.6g}, expected qx, qy, qz, qw of length 1 (within "
            f"{QUATERNION_TOLERANCE:g})"
        )
    return rotations.from_quaternion(q)


def _of_matrix(R: Array, where: str) -> Array:
    if not (
        np.abs(R).max() <= 2 and np.abs(R @ R.T - np.eye(3)).max() <= MAX_ORTHOGONALITY_ERROR and np.linalg.det(R) > 0
    ):
        raise InputError(f"{where}: found no rigid transform, expected a rotation matrix by its rows")
    return rotations.nearest(R)


@record
class PatternPoseFiles:
    """Measured poses of the pattern, in the camera's frame."""

    file: Path | None = field(
        "File, folder or pattern of files as of 'samples' (the same).",
        default=None,
    )
    form: PoseForm = field(flat=True, default_factory=PoseForm)
