"""Types of values in a system's description: vectors, poses, intervals, and angles in degrees."""

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import Constraint, Converted, between, field, record
from calibration.engine.geometry.transforms import from_xyz_rpy

MAX_BYTES = 10_000_000
"""Limit of a file's size: far above that of any robot, system or motion."""


def listed(count: int, expected: str, holds: Callable[[Any], bool] = lambda _: True) -> Constraint:
    """Constraint to lists of this many numbers that meet a condition."""
    return Constraint(
        lambda numbers: len(numbers) == count and holds(numbers), expected, {"length": (count, count)}, whole=True
    )


def rising(least: float = -math.inf, most: float = math.inf) -> Constraint:
    """Constraint to intervals [low, high] within inclusive limits."""
    limits = f"from {least:g} to {most:g}" if math.isfinite(most) else f"of at least {least:g}"
    return listed(2, f"two rising numbers {limits}", lambda ends: least <= ends[0] <= ends[1] <= most)


def degrees(least: float, most: float) -> Converted:
    """Angle in degrees in the document and in radians in the record."""
    return Converted(Annotated[float, between(least, most)], lambda angle, _: math.radians(angle))


def array(constraint: Constraint) -> Converted:
    """List of numbers, as an array."""
    return Converted(Annotated[tuple[float, ...], constraint], lambda numbers, _: np.array(numbers))


Vector = Annotated[tuple[float, float, float], listed(3, "three numbers: x, y, z")]
Radians = Annotated[tuple[float, float, float], listed(3, "three numbers: roll, pitch, yaw")]


@record(case="snake", nulls=True)
class Pose:
    """Position and orientation of a frame."""

    xyz: Vector = field("Position, m.", default=(0.0, 0.0, 0.0))
    rpy: Radians = field("Roll, pitch, yaw, rad.", default=(0.0, 0.0, 0.0))

    @property
    def transform(self) -> Array:
        """Return the transform (4, 4)."""
        return from_xyz_rpy(self.xyz, self.rpy)
