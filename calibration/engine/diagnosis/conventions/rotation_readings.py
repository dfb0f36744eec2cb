"""Rotations read by another convention than they were written by.

A pose file has three or four numbers for a rotation; read by the wrong convention they are still a rotation, of which
the numbers can be had back, up to turns that the wrong reading has lost (`Reading.numbers` returns every branch).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.geometry import rotations

TURNED_TWICE = np.pi + 1e-6
"""rad: limit of an angle that a file holds."""
MOST_DEGREES = 180.0
"""Limit of the length of a rotation vector in degrees."""
RADIANS_PER_DEGREE = np.pi / 180
Axes = tuple[int, int, int]
"""0, 1, 2: x, y, z, in the order of the angles."""

QUATERNION_ORDERS = (("wxyz", "xyzw"), ("xyzw", "wxyz"))
"""Orders as they may be written, and as they are read then."""


@dataclass(frozen=True, eq=False)
class Reading:
    """A convention for the numbers of a rotation."""

    name: str
    """As in "rotations written as NAME"."""
    key: str
    """``rotation`` in import.yml."""
    rotation: Callable[[Array], Array]
    """From numbers (..., k) to rotations (..., 3, 3)."""
    numbers: Callable[[Array], Array]
    """From rotations (N, 3, 3) to the numbers (N, b, k) that may have been read, in b branches; NaN where there are
    fewer."""


@dataclass(frozen=True, eq=False)
class Rereading:
    """Rotations that were written by one convention and read by another."""

    written: str
    read: str
    keys: str
    """The keys of import.yml by which they are read as they were written."""
    branches: Array
    """(N, b, 3, 3): the rotations that may have been meant; NaN where there are fewer."""


def rereadings(R: Array) -> Iterator[Rereading]:
    """Yield what rotations (N, 3, 3) may have been before they were read wrongly; the usual mistakes first."""
    x, y, z, w = np.moveaxis(rotations.to_quaternion(R), -1, 0)
    for (written, read), q in zip(QUATERNION_ORDERS, ((y, z, w, x), (w, x, y, z)), strict=True):
        branches = rotations.from_quaternion(np.stack(q, -1))[:, None]
        yield Rereading(f"quaternions {written}", f"quaternions {read}", f"rotation: quaternion-{written}", branches)
    vector = rotations.log(R)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    turns = np.arange(-int(MOST_DEGREES // (2 * np.pi)) - 1, int(MOST_DEGREES // (2 * np.pi)) + 1)
    degrees = length + 2 * np.pi * turns
    direction = vector / np.maximum(length, 1e-12)
    meant = rotations.exp(direction[:, None] * (RADIANS_PER_DEGREE * degrees)[..., None])
    meant = _keep_branches(meant, abs(degrees) <= MOST_DEGREES)
    yield Rereading("rotation vectors in degrees", "radians", "rotation: rotvec, degrees: true", meant)
    small = THREE_NUMBER_READINGS if bool((length < np.sqrt(3) * np.pi * RADIANS_PER_DEGREE).all()) else ()
    for one in small:
        keys = f"rotation: {one.key}, degrees: false"
        yield Rereading(f"{one.name} in radians", "degrees", keys, one.rotation(one.numbers(R) / RADIANS_PER_DEGREE))
    for one in THREE_NUMBER_READINGS:
        numbers = one.numbers(R)
        for other in THREE_NUMBER_READINGS:
            if other is not one:
                yield Rereading(other.name, one.name, f"rotation: {other.key}", other.rotation(numbers))


def _keep_branches(branches: Array, there: Array) -> Array:
    return np.where(there[..., None, None], branches, np.nan)


def _numbers_of_vector(R: Array) -> Array:
    """Return rotation vectors (N, 2, 3): the shortest, and that of the other direction, of up to 2 pi."""
    vector = rotations.log(R)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    other = vector * (1 - 2 * np.pi / np.maximum(length, 1e-12))
    return np.stack([vector, np.where(abs(other) <= TURNED_TWICE, other, np.nan)], 1)


def euler(axes: Axes, angles: Array) -> Array:
    """Return the rotations (..., 3, 3) of angles (..., 3) about moving axes, one after the other."""
    parts = [rotations.exp(angles[..., k, None] * np.eye(3)[axis]) for k, axis in enumerate(axes)]
    R: Array = parts[0] @ parts[1] @ parts[2]
    return R


def euler_angles(axes: Axes, R: Array) -> Array:
    """Return the angles (N, 2, 3) of `euler`, of both branches, each in [-pi, pi]."""
    i, j, last = axes
    k = 3 - i - j
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    if last == i:
        a = np.arctan2(R[:, j, i], -parity * R[:, k, i])
        b = np.arccos(np.clip(R[:, i, i], -1, 1))
        c = np.arctan2(R[:, i, j], parity * R[:, i, k])
        other = (a + np.pi, -b, c + np.pi)
    else:
        a = np.arctan2(-parity * R[:, j, k], R[:, k, k])
        b = np.arcsin(np.clip(parity * R[:, i, k], -1, 1))
        c = np.arctan2(-parity * R[:, i, j], R[:, i, i])
        other = (a + np.pi, np.pi - b, c + np.pi)
    both = np.stack([np.stack([a, b, c], -1), np.stack(other, -1)], 1)
    return np.asarray((both + np.pi) % (2 * np.pi) - np.pi)


def _about_fixed_axes(axes: Axes, angles: Array) -> Array:
    return euler(axes[::-1], angles[..., ::-1])


def _angles_about_fixed_axes(axes: Axes, R: Array) -> Array:
    return np.asarray(euler_angles(axes[::-1], R)[..., ::-1])


def _euler_readings() -> Iterator[Reading]:
    usual: list[Axes] = [(0, 1, 2), (2, 1, 0), (2, 1, 2), (2, 0, 2)]
    every: list[Axes] = [*usual, *((i, j, 3 - i - j) for i, j in permutations(range(3), 2))]
    every += [(i, j, i) for i, j in permutations(range(3), 2)]
    for axes in dict.fromkeys(every):
        letters = ["xyz"[axis] for axis in axes]
        named, key = ", ".join(letters), f"euler-{''.join(letters)}"
        fixed = partial(_about_fixed_axes, axes), partial(_angles_about_fixed_axes, axes)
        moving = partial(euler, axes), partial(euler_angles, axes)
        yield Reading(f"Euler angles about the fixed axes {named}", f"{key}-extrinsic", *fixed)
        yield Reading(f"Euler angles about the moving axes {named}", f"{key}-intrinsic", *moving)


THREE_NUMBER_READINGS = (Reading("rotation vectors", "rotvec", rotations.exp, _numbers_of_vector), *_euler_readings())
"""Conventions of three numbers, the usual ones first."""
