"""What stands around the robot: the ground and boxes, which rays hit.

A wall is a thin box. The distance to what a ray hits is counted in lengths of the ray's direction,
which need not be 1: with ``direction = target - origin`` a hit below 1 hides the target.
"""

from dataclasses import dataclass

import numpy as np

from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray


@dataclass(frozen=True, eq=False)
class Box:
    """A cuboid about its own centre."""

    T_world_box: Array
    """(4, 4)."""
    size: Array
    """(3,): the lengths of its edges, m."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The ground, a plane z = height in the world frame, and boxes; what is absent hides nothing."""

    ground: float | None = None
    """The height of the ground, m."""
    boxes: tuple[Box, ...] = ()

    def cast(self, origin: Array, directions: Array) -> Array:
        """The distances (...) along rays to the nearest surface in front; infinite where there is none.

        Args:
            origin: (..., 3) in the world frame; broadcasts against the directions' batch axes.
            directions: (..., 3), of any length but 0.
        """
        origins = np.moveaxis(np.asarray(origin, float), -1, 0)
        rays = np.ascontiguousarray(np.moveaxis(directions, -1, 0))
        nearest = np.full(directions.shape[:-1], np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.ground is not None:
                t = (self.ground - origins[2]) / rays[2]
                nearest = np.where(t > 0, t, nearest)
            for box in self.boxes:
                nearest = np.fmin(nearest, _cast_at_box(box, origins, rays))
        return nearest

    def hides(self, origin: Array, points: Array) -> BoolArray:
        """Which points (..., K, 3) cannot be seen from the origins (..., 3)."""
        start = np.asarray(origin, float)[..., None, :]
        hidden: BoolArray = self.cast(start, points - start) < 1 - 1e-9
        return hidden

    def contains(self, points: Array, clearance: float = 0.0) -> BoolArray:
        """Which points (..., 3) lie in a box or under the ground, or nearer to one than the clearance."""
        inside = np.zeros(points.shape[:-1], bool)
        if self.ground is not None:
            inside |= points[..., 2] < self.ground + clearance
        for box in self.boxes:
            local = apply(inverse(box.T_world_box), points)
            inside |= (np.abs(local) < box.size / 2 + clearance).all(-1)
        return inside


def _cast_at_box(box: Box, origins: Array, rays: Array) -> Array:
    """The distances to one box, infinite where it is missed; coordinates stand on the first axis.

    The slab method: a ray is inside the box while it is between all three pairs of faces (T. Kay
    and J. Kajiya, "Ray tracing complex scenes", 1986). From inside the box it sees the far face.
    """
    R, centre, half = box.T_world_box[:3, :3], box.T_world_box[:3, 3], box.size / 2
    enter: Array | float = -np.inf
    leave: Array | float = np.inf
    for axis in range(3):
        x, y, z = R[:, axis]
        o = x * (origins[0] - centre[0]) + y * (origins[1] - centre[1]) + z * (origins[2] - centre[2])
        slope = 1 / (x * rays[0] + y * rays[1] + z * rays[2])
        a, b = (-half[axis] - o) * slope, (half[axis] - o) * slope
        enter, leave = np.maximum(enter, np.minimum(a, b)), np.minimum(leave, np.maximum(a, b))
    hit: Array = np.where((enter <= leave) & (leave > 0), np.where(enter > 0, enter, leave), np.inf)
    return hit
