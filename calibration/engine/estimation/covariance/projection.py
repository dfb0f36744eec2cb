"""Uncertainty of a calibrated camera's projection: by how many pixels it misses a known point, all over the image.

Intrinsics and the camera's own pose make up for each other: a principal point that is off looks like a camera that is
turned, and a camera whose intrinsics are calibrated again is also placed again. So does a camera whose intrinsics are
given: it is placed with them. So a change of the intrinsics counts by
what remains of it once the camera has moved to where its corners fit best: the uncertainty of projection of mrcal
(D. Kogan, "mrcal: projection uncertainty"), with the pose fitted to all corners. It depends on how far away a point is;
it is largest at infinity or very near, and smallest where the patterns were.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.estimation.covariance.lens_errors import LensErrors, lens_errors
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply

GRID_COLUMNS, GRID_ROWS = 24, 18
"""Number of columns and rows of the grid over the image."""
JUDGED_SHARE_OF_IMAGE = 0.9
"""Part of the image with corners in which an error stays below what is judged; single corners at its border are out."""


@dataclass(frozen=True, eq=False)
class Projection:
    """Projection of a calibrated camera over a grid of R rows and C columns, and how the intrinsics change it."""

    camera: Camera
    """Calibrated."""
    at: tuple[int, ...]
    """(k,): indices of the intrinsics that may be wrong, among `Camera.parameters`."""
    gain: Array
    """(6, k): twist of the scene in the camera's frame (m, rad) that makes up best for each of these intrinsics."""
    distance: float
    """Median distance of the corners, m."""
    seen: BoolArray
    """(R, C): the cells with corners."""

    normals: Array
    """(V, 3): of the patterns in the camera's frame, view by view."""

    @cached_property
    def pixels(self) -> Array:
        """Centres (R, C, 2) of the cells, px."""
        u = (np.arange(GRID_COLUMNS) + 0.5) * self.camera.width / GRID_COLUMNS - 0.5
        v = (np.arange(GRID_ROWS) + 0.5) * self.camera.height / GRID_ROWS - 0.5
        return np.stack(np.meshgrid(u, v), -1)

    def changes(self, distance: float = np.inf) -> Array:
        """Return the change (R, C, 2, k) of the pixels of points, px per unit of each of the intrinsics.

        NaN where the lens has no ray.

        Args:
            distance: of the points, m.
        """
        x, y = self.camera.from_pixels(*np.moveaxis(self.pixels, -1, 0))
        rays = self.camera.distortion.chart.rays(x, y)
        rays = rays / np.linalg.norm(rays, axis=0)
        own = np.moveaxis(self.camera.derivatives(x, y)[list(self.at)], (0, 1), (-1, -2))
        return own + _of_twist(self.camera, rays, distance) @ self.gain

    def sigmas(self, covariance: Array, distance: float = np.inf) -> Array:
        """Return the standard deviation (R, C) of the projection in its worst direction, px.

        Args:
            covariance: (k, k), of the intrinsics.
            distance: of the points, m.
        """
        J = self.changes(distance)
        C = J @ covariance @ np.swapaxes(J, -1, -2)
        a, b, c = C[..., 0, 0], C[..., 0, 1], C[..., 1, 1]
        return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))

    def shift(self, changes: Array) -> float:
        """Return by how much changes (k,) of the intrinsics shift points at the patterns' distance, as `most`."""
        return self.most(np.linalg.norm(self.changes(self.distance) @ changes, axis=-1))

    def most(self, values: Array) -> float:
        """Return what values (R, C) do not exceed in nine tenths of the cells with corners."""
        return float(np.nanquantile(values[self.seen], JUDGED_SHARE_OF_IMAGE))


def given_lens(calibration: Calibration, name: str) -> LensErrors | None:
    """Return the errors of a camera's intrinsics that are given; None if they are calibrated, or exactly known."""
    solution = calibration.solution
    sensor = solution.dataset.sensors[name]
    blocks = (block.intrinsics for block in solution.setup.problem.blocks)
    prior = next((each.prior for each in blocks if each and each.sensor == name), None)
    if sensor.camera is None or name in calibration.intrinsics:
        return None
    lens = lens_errors(sensor.camera, solution.assume, prior or sensor.uncertainty)
    return None if lens.is_exact else lens


def projection_of(calibration: Calibration, name: str, at: tuple[int, ...] | None = None) -> Projection:
    """Return the projection of a camera that has seen patterns.

    Args:
        calibration: the calibration.
        name: of the camera.
        at: indices of the intrinsics that may be wrong, among `Camera.parameters`; None for those that are calibrated.
    """
    solution = calibration.solution
    problem, values = solution.setup.problem, solution.values
    if at is None:
        at = tuple(next(b.intrinsics.at for b in problem.blocks if b.intrinsics and b.intrinsics.sensor == name))
    camera = solution.dataset.sensors[name].camera
    if camera is None:
        raise AssertionError("a camera has intrinsics")
    points, normals = [], []
    for group in problem.groups:
        if group.sensor == name:
            pattern = solution.dataset.patterns[group.pattern]
            for T, i in zip(problem.poses(group, values), group.collections, strict=True):
                labels = solution.dataset.collections[i].labels[group.pattern, name]
                if isinstance(labels, CornerLabels):
                    points.append(apply(T, pattern.corners[labels.ids] - pattern.centre))
                    normals.append(T[:3, 2])
    scene: Array = np.concatenate(points)
    x, y = camera.distortion.chart.coordinates(scene.T, camera.distortion.sees)
    own = np.moveaxis(camera.derivatives(x, y)[list(at)], (0, 1), (-1, -2)).reshape(-1, len(at))
    moved = _of_twist(camera, scene.T).reshape(-1, 6)
    gain = -np.asarray(np.linalg.lstsq(moved, own, rcond=None)[0], float)
    distance = float(np.median(np.linalg.norm(scene, axis=-1)))
    return Projection(
        camera, at, gain, distance, cells_with_pixels(camera, camera.to_pixels(x, y)) > 0, np.array(normals, float)
    )


def _of_twist(camera: Camera, points: Array, distance: float = 1.0) -> Array:
    """Derivatives (..., 2, 6) of the pixels of points by a twist of the scene in the camera's frame, m and rad.

    Args:
        camera: the camera.
        points: (3, ...), of which the lens sees all.
        distance: by which they are multiplied; infinite for directions.
    """
    x, y, z = points
    none = np.zeros_like(x)
    turns = np.array([(none, z, -y), (-z, none, x), (y, -x, none)])  # of dw x P, for each axis of dw
    slopes = camera.slopes(points)
    by_turn = np.einsum("ij...,jk...->ik...", slopes, turns)
    return np.moveaxis(np.concatenate([slopes / distance, by_turn], 1), (0, 1), (-2, -1))


def cells_with_pixels(camera: Camera, pixels: Array, weights: Array | None = None) -> Array:
    """Return how many of the pixels (n, 2) are in each cell (R, C), or the sum of their weights (n,)."""
    column = np.clip((pixels[:, 0] + 0.5) / camera.width * GRID_COLUMNS, 0, GRID_COLUMNS - 1).astype(int)
    row = np.clip((pixels[:, 1] + 0.5) / camera.height * GRID_ROWS, 0, GRID_ROWS - 1).astype(int)
    sums = np.bincount(row * GRID_COLUMNS + column, weights, GRID_ROWS * GRID_COLUMNS)
    return np.asarray(sums.reshape(GRID_ROWS, GRID_COLUMNS), float)
