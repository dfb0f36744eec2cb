"""Scene around the robot: ground, boxes and light, and patterns as objects in it, with ray casting.

A wall is a thin box. The distance along a ray is in lengths of the ray's direction,
which need not be 1: with ``direction = target - origin`` a hit below 1 occludes the target.

Also the types of values in the description of a system: vectors, poses, intervals, and angles in degrees.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.base.records import Constraint, Converted, between, field, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, translation

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


NO_SURFACE, GROUND_SURFACE = -2, -1
"""Indices of surfaces that are not boxes; boxes count from 0."""
MAX_LIGHT = 10.0


def turned(T_parent_child: Array, directions: Array) -> Array:
    """Rotate directions (3, ...) from the child frame to the parent frame, with coordinates on the first axis.

    Written out, as a matrix product is rounded differently on different processors.
    """
    x, y, z = directions
    found, term = np.empty(directions.shape), np.empty(directions.shape[1:])
    for number, row in enumerate(T_parent_child[:3, :3]):
        part = found[number, ...]
        np.multiply(row[0], x, out=part)
        part += np.multiply(row[1], y, out=term)
        part += np.multiply(row[2], z, out=term)
    return found


_THREE_LENGTHS = listed(3, "three lengths above 0", lambda lengths: min(lengths) > 0)
_RGB_COLOUR = listed(
    3, "three numbers from 0 to 255: red, green, blue", lambda colour: min(colour) >= 0 and max(colour) <= 255
)
_LIGHT_DIRECTION = listed(3, "a direction [x, y, z] towards the light", any)


@record(case="snake", nulls=True)
class BoxPose:
    """Pose of a box in the world."""

    centre: Vector = field("Its centre, m.")
    rpy: Radians = field("Roll, pitch, yaw, rad.", default=(0.0, 0.0, 0.0))


@record(case="snake", nulls=True, eq=False)
class Box:
    """Cuboid around its own centre."""

    T_world_box: Annotated[Array, Converted(BoxPose, lambda pose, _: from_xyz_rpy(pose.centre, pose.rpy))] = field(
        flat=True
    )
    """(4, 4)."""
    size: Annotated[Array, array(_THREE_LENGTHS)] = field("Lengths of its edges, m.")
    """(3,)."""
    colour: Annotated[tuple[float, float, float], _RGB_COLOUR] = field(
        "Red, green and blue, 0 to 255, under a light of 1.", default=(168.0, 164.0, 156.0)
    )


def _from_above() -> Array:
    return np.array([-0.5, 0.4, 1.0])


@record(case="snake", nulls=True, eq=False)
class Light:
    """Ambient light, and directional light from far away; without shadows."""

    ambient: Annotated[float, between(0, MAX_LIGHT)] = field("Light from everywhere.", default=0.75)
    intensity: Annotated[float, between(0, MAX_LIGHT)] = field(
        "Light from one direction, on a surface square to it.", default=0.35
    )
    direction: Annotated[Array, array(_LIGHT_DIRECTION)] = field(
        "Direction towards the light, in the world frame, of any length but 0.", default_factory=_from_above
    )
    """(3,)."""

    def on(self, normals: Array) -> Array:
        """Return the light (...) on surfaces with unit normals (..., 3) towards the viewer, by Lambert's law."""
        x, y, z = self.direction / math.hypot(*self.direction)
        towards = normals[..., 0] * x + normals[..., 1] * y + normals[..., 2] * z
        return np.asarray(self.ambient + self.intensity * np.maximum(towards, 0.0))


@record(case="snake", nulls=True, eq=False)
class Scene:
    """Ground, a plane z = height in the world frame, and boxes; absent parts occlude nothing."""

    ground: float | None = field(
        "Height of the ground, m; without it there is no ground.", default=None, key="ground_m"
    )
    boxes: tuple[Box, ...] = field("Boxes: walls, furniture.", default=())
    light: Light = field("Light on all of it.", default_factory=Light)

    def cast(self, origin: Array, directions: Array) -> Array:
        """Return the distances (...) along rays to the nearest surface in front; infinite if there is none.

        Args:
            origin: (..., 3) in the world frame; broadcasts against the directions' batch axes.
            directions: (..., 3), of any length but 0.
        """
        rays = np.ascontiguousarray(np.moveaxis(directions, -1, 0))
        return self.hit(np.moveaxis(np.asarray(origin, float), -1, 0), rays)[0]

    def hit(self, origin: Array, rays: Array) -> tuple[Array, IntArray]:
        """Intersect rays (3, ...) from one point (3,), or from one each, in the world frame.

        Returns:
            The distances (...) as in `cast`, and the surface (...): the index of a box, `GROUND_SURFACE` or
            `NO_SURFACE`.
        """
        nearest = np.full(rays.shape[1:], np.inf)
        surface = np.full(rays.shape[1:], NO_SURFACE)
        with np.errstate(divide="ignore", invalid="ignore"):
            for index, distance in self._surface_distances(origin, rays):
                np.copyto(surface, index, where=distance < nearest)
                np.fmin(nearest, distance, out=nearest)
        return nearest, surface

    def _surface_distances(self, origins: Array, rays: Array) -> Iterator[tuple[int, Array]]:
        """Yield index and distances of the ground, if there is one, and of every box; coordinates on the first axis."""
        if self.ground is not None:
            t = (self.ground - origins[2]) / rays[2]
            yield GROUND_SURFACE, np.where(t > 0, t, np.inf)
        for index, box in enumerate(self.boxes):
            yield index, _cast_at_box(box, origins, rays)

    def hides(self, origin: Array, points: Array) -> BoolArray:
        """Return a mask (..., K) of the points (..., K, 3) that are occluded from the origins (..., 3)."""
        start = np.asarray(origin, float)[..., None, :]
        return self.cast(start, points - start) < 1 - 1e-9

    def contains(self, points: Array, clearance: float = 0.0) -> BoolArray:
        """Return a mask of the points (..., 3) in a box or under the ground, or closer to them than the clearance."""
        inside = np.zeros(points.shape[:-1], bool)
        if self.ground is not None:
            inside |= points[..., 2] < self.ground + clearance
        for box in self.boxes:
            local = apply(inverse(box.T_world_box), points)
            inside |= (np.abs(local) < box.size / 2 + clearance).all(-1)
        return inside


def _cast_at_box(box: Box, origins: Array, rays: Array) -> Array:
    """Return the distances to one box, infinite for rays that miss it; coordinates are on the first axis.

    The slab method: a ray is inside the box while it is between all three pairs of faces (T. Kay
    and J. Kajiya, "Ray tracing complex scenes", 1986). From inside the box it sees the far face.
    """
    enter: Array | float = -np.inf
    leave: Array | float = np.inf
    for axis in range(3):
        first, second = between_faces(box, axis, origins, rays)
        enter, leave = np.maximum(enter, first), np.minimum(leave, second)
    return np.where((enter <= leave) & (leave > 0), np.where(enter > 0, enter, leave), np.inf)


def between_faces(box: Box, axis: int, origins: Array, rays: Array) -> tuple[Array, Array]:
    """Return the distances to the planes of two opposite faces of a box, the nearer first; coordinates as above."""
    (x, y, z), centre, half = box.T_world_box[:3, axis], box.T_world_box[:3, 3], box.size[axis] / 2
    o = x * (origins[0] - centre[0]) + y * (origins[1] - centre[1]) + z * (origins[2] - centre[2])
    slope = 1 / (x * rays[0] + y * rays[1] + z * rays[2])
    a, b = (-half - o) * slope, (half - o) * slope
    return np.minimum(a, b), np.maximum(a, b)


@dataclass(frozen=True, eq=False)
class Board:
    """Pattern as an object: a sheet of zero thickness inside its rectangular border.

    The sheet is ``z = -bow_x (1 - X^2) - bow_y (1 - Y^2)`` in the pattern frame, where X and Y range from
    -1 to 1 across the border. A corner (x, y, 0) of a flat board becomes (x, y, z) on a bowed one: the bow is so
    small that lengths along the sheet are unchanged.
    """

    configuration: PatternConfiguration
    """Description of its print."""
    pattern: Pattern
    """Geometry of the flat pattern."""
    T_world_pattern: Array
    """(4, 4)."""
    bow: tuple[float, float] = (0.0, 0.0)
    """Height of the centre towards the viewer, along x and along y, m; 0 is flat."""
    legacy_layout: bool = False
    """Whether a charuco board has OpenCV's layout of before 4.6."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """Minimum and maximum of x and y on the board, (2,) each."""
        return self.pattern.outline.min(axis=0), self.pattern.outline.max(axis=0)

    def surface(self, points: Array) -> Array:
        """Return the points (..., 3) of the sheet at (x, y), (..., 2); all in the pattern frame."""
        low, high = self.limits
        across = (points - (low + high) / 2) / ((high - low) / 2)
        z = -self.bow[0] * (1 - across[..., 0] ** 2) - self.bow[1] * (1 - across[..., 1] ** 2)
        return np.concatenate([points, z[..., None]], -1)

    def corners(self) -> Array:
        """Corners (4, 3) of the border in the world frame."""
        return apply(self.T_world_pattern, self.surface(self.pattern.outline))

    def meet(self, start: Array, directions: Array) -> Array:
        """Intersect rays with the sheet, continued beyond the border: distances (...); NaN without an intersection.

        A bowed sheet may be intersected twice: the nearer intersection on the board is returned, and if none is on the
        board, the one that exists for a flat sheet too.

        Args:
            start: (3,) in the pattern frame.
            directions: (3, ...) in the pattern frame, of any length but 0, which is the unit of the distances.
        """
        x, y, z = directions
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.bow == (0.0, 0.0):
                flat: Array = -start[2] / z
                return np.where(np.isfinite(flat), flat, np.nan)
            # z + bow_x (1 - X^2) + bow_y (1 - Y^2) along the ray: a t^2 + b t + c
            low, high = self.limits
            (px, py), (hx, hy) = start[:2] - (low + high) / 2, (high - low) / 2
            kx, ky = self.bow[0] / hx**2, self.bow[1] / hy**2
            a = -(kx * (x * x) + ky * (y * y))
            b = z - 2 * (kx * px * x + ky * py * y)
            c = start[2] + self.bow[0] + self.bow[1] - kx * px**2 - ky * py**2
            q = -0.5 * (b + np.copysign(np.sqrt(b * b - 4 * a * c), b))
            first, second = c / q, q / a
            hits_first = self._on_board(start, directions, first) & ~(second < first)
            t: Array = np.where(self._on_board(start, directions, second) & ~hits_first, second, first)
            return np.where(np.isfinite(t), t, np.nan)

    def shows_print(self, start: Array, directions: Array, t: Array) -> BoolArray:
        """Return a mask (...) of the rays that hit the printed side at distances t; arguments as in `meet`."""
        low, high = self.limits
        slope_x = 2 * self.bow[0] / ((high[0] - low[0]) / 2) ** 2
        slope_y = 2 * self.bow[1] / ((high[1] - low[1]) / 2) ** 2
        x, y, z = directions
        middle_x, middle_y = (low + high) / 2
        with np.errstate(invalid="ignore", over="ignore"):
            along_x = slope_x * (start[0] - middle_x + t * x) * x if slope_x else 0.0
            along_y = slope_y * (start[1] - middle_y + t * y) * y if slope_y else 0.0
            printed: BoolArray = z - along_x - along_y > 0
        return printed

    def cast(self, origin: Array, directions: Array) -> Array:
        """Return the distances (...) along rays from one point (3,); infinite for rays that miss. See `Scene.cast`."""
        return self.cast_in(translation(-origin) @ self.T_world_pattern, np.moveaxis(directions, -1, 0))

    def cast_in(self, T_frame_pattern: Array, directions: Array) -> Array:
        """Return the distances (...) along rays (3, ...) from the origin of a frame; infinite for rays that miss."""
        T_pattern_frame = inverse(T_frame_pattern)
        start, rays = T_pattern_frame[:3, 3], turned(T_pattern_frame, directions)
        t = self.meet(start, rays)
        return np.where(self._on_board(start, rays, t), t, np.inf)

    def _on_board(self, start: Array, directions: Array, t: Array) -> BoolArray:
        """Whether rays at distances t (...), in front, are inside the border."""
        low, high = self.limits
        with np.errstate(invalid="ignore", over="ignore"):
            x, y = start[0] + t * directions[0], start[1] + t * directions[1]
            return np.asarray((t > 0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))
