"""Poses in plain Python, for machines without numpy: a translation, m, and a quaternion xyzw."""

import math
from collections.abc import Sequence
from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Pose(NamedTuple):
    """``T_parent_child``."""

    trans: Vector
    quat: Quaternion
    """As it is in use: it may not have the length 1."""

    def __matmul__(self, other: "Pose") -> "Pose":
        moved = _rotated(self.quat, other.trans)
        x, y, z = (a + b for a, b in zip(self.trans, moved, strict=True))
        return Pose((x, y, z), _product(self.quat, other.quat))


def pose_of(numbers: Sequence[float]) -> Pose:
    """Return the pose of x, y, z and a quaternion xyzw."""
    x, y, z, *quat = numbers
    a, b, c, d = quat
    return Pose((x, y, z), (a, b, c, d))


def pose_of_angles(xyz: Sequence[float], rpy: Sequence[float]) -> Pose:
    """Return the pose of a translation, and of roll, pitch and yaw about fixed axes, rad, as in a URDF."""
    (x, y, z), quat = xyz, (0.0, 0.0, 0.0, 1.0)
    for axis, angle in enumerate(rpy):
        turn = [0.0, 0.0, 0.0, math.cos(angle / 2)]
        turn[axis] = math.sin(angle / 2)
        quat = _product((turn[0], turn[1], turn[2], turn[3]), quat)
    return Pose((x, y, z), quat)


def distance_of_poses(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance of two poses, mm and degrees; a quaternion whose length is not 1 counts as a rotation too."""
    same, opposite = (math.dist(one.quat, tuple(sign * value for value in other.quat)) for sign in (1.0, -1.0))
    return 1e3 * math.dist(one.trans, other.trans), math.degrees(2 * min(same, opposite))


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    (px, py, pz, pw), (qx, qy, qz, qw) = p, q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def _rotated(quat: Quaternion, vector: Vector) -> Vector:
    length = sum(value * value for value in quat) or 1.0
    x, y, z, w = quat
    found = _product(_product(quat, (*vector, 0.0)), (-x, -y, -z, w))
    return found[0] / length, found[1] / length, found[2] / length
