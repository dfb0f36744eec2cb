"""Patterns as objects of the scene: print, pose and flatness."""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.transforms import apply, inverse, translation
from calibration.robot.simulation.scene import turned


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
            inside: BoolArray = (t > 0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
            return inside
