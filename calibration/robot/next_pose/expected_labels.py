"""Labels that the sensors of a recording would have of a pattern elsewhere, by what they had of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels, PoseLabels, Sensor
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern
from calibration.engine.estimation.residuals.ray_residuals import RING_GAP
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.simulation.sensors.sensor import meets

MIN_SPACING_PX = 16.0
"""Distance of neighbouring corners in the image below which they may not be found."""
NEARER, FARTHER = 0.8, 1.25
"""Part of the nearest and the farthest distance at which a pattern was seen: beyond, focus and detector may fail."""
NEIGHBOURS = 1.1
"""Distance of neighbouring corners, in the smallest of the board."""
MIN_SHARE = 0.7
"""Share of the corners of a board with markers that are in the image: a hand does not hold it exactly there."""
MAX_TILT = np.radians(60)
"""Angle between a pattern's normal and the line of sight up to which it is found."""
MIN_POINTS = 10
"""Fewest points of a LiDAR or a depth camera on a pattern."""


def expected_labels(recorded: Dataset, poses: Dataset, sensor: Sensor, pattern: Pattern) -> dict[int, Labels]:
    """Return the exact labels that a sensor is expected to have of a pattern, by the index of the pose.

    Args:
        recorded: the calibrated recording, which says what the sensor had seen of it.
        poses: M collections with the transforms of the poses.
        sensor: the sensor.
        pattern: the pattern.
    """
    seen = [(i, label) for i, label in recorded.detections(pattern.name, sensor.name)]
    if not seen:
        return {}
    T = poses.transform(sensor.frame, pattern.link)
    low, high = distances(recorded, sensor, pattern)
    far = np.linalg.norm(apply(T, pattern.centre[None])[:, 0], axis=-1)
    may_be_seen = (far > low) & (far < high) & _facing(T, pattern)
    first = seen[0][1]
    if isinstance(first, PoseLabels):
        return {i: PoseLabels(T[i]) for i in range(len(T))}
    if isinstance(first, CornerLabels):
        return {} if sensor.camera is None else _corners(sensor.camera, pattern, T, may_be_seen)
    points = [label.points for _, label in seen if isinstance(label, PointLabels)]
    rays = _pixel_rays(sensor.camera, points) if sensor.camera is not None else ring_rays(points)
    found = ((i, _points(rays, pattern, T[i])) for i in np.flatnonzero(may_be_seen).tolist())
    return {i: label for i, label in found if label is not None}


def distances(recorded: Dataset, sensor: Sensor, pattern: Pattern) -> tuple[float, float]:
    """Return the distances at which a sensor saw a pattern, a little nearer and farther, m."""
    at = np.array([i for i, _ in recorded.detections(pattern.name, sensor.name)])
    centres = apply(recorded.transform(sensor.frame, pattern.link, at), pattern.centre[None])[:, 0]
    seen = np.linalg.norm(centres, axis=-1)
    return NEARER * float(seen.min()), FARTHER * float(seen.max())


def _corners(camera: Camera, pattern: Pattern, T: Array, may_be_seen: BoolArray) -> dict[int, Labels]:
    pixels, ahead = camera.project_visible(apply(T, pattern.corners))
    spacing = _spacing(pixels, pattern)
    border = spacing[:, None, None]  # the squares around a corner are seen too
    inside = ahead & ((pixels > border) & (pixels < np.array([camera.width, camera.height]) - 1 - border)).all(-1)
    share = 1.0 if pattern.kind in UNMARKED_KINDS else MIN_SHARE
    kept = np.flatnonzero((inside.mean(-1) >= share) & may_be_seen & (spacing > MIN_SPACING_PX))
    ids = np.arange(len(pattern.corners))
    return {i: CornerLabels(ids[inside[i]], pixels[i, inside[i]]) for i in kept.tolist()}


def _spacing(pixels: Array, pattern: Pattern) -> Array:
    """Return the smallest distance (M,) in the image of corners that are neighbours on the board."""
    apart = np.linalg.norm(pattern.corners[:, None] - pattern.corners, axis=-1)
    apart[np.tril_indices(len(apart))] = np.inf
    a, b = np.nonzero(apart < NEIGHBOURS * apart.min())
    return np.asarray(np.linalg.norm(pixels[:, a] - pixels[:, b], axis=-1).min(-1))


def _facing(T: Array, pattern: Pattern) -> BoolArray:
    """Return a mask (M,) of the poses at which a pattern faces the sensor: its z axis points away from it."""
    centre = apply(T, pattern.centre[None])[:, 0]
    along = (centre * T[:, :3, 2]).sum(-1) / np.linalg.norm(centre, axis=-1)
    return np.asarray(along > np.cos(MAX_TILT))


@dataclass(frozen=True, eq=False)
class RayGrid:
    """Rays of a sensor: rows of equal polar angle, or rows of pixels."""

    rays: Array
    """(R, A, 3): unit vectors, row by row."""
    has_border: bool
    """Whether the first and last point of a row tell where the border is: rows are rings, by equal steps in azimuth."""

    def leaves_rings(self, outline: Array) -> bool:
        """Whether an outline (4, 3) reaches above or below the rings; those of a 2D LiDAR are one."""
        if not self.has_border or len(self.rays) == 1:
            return False
        z = outline[:, 2] / np.linalg.norm(outline, axis=-1)
        rings = self.rays[:, 0, 2]
        return bool(z.max() > rings.max() or z.min() < rings.min())

    def towards(self, outline: Array) -> Array:
        """Return the rays (R, a, 3) that may meet what is within an outline (4, 3)."""
        if not self.has_border:
            return self.rays
        middle = outline.mean(0)
        x, y = outline[:, :2] @ middle[:2], outline[:, :2] @ (-middle[1], middle[0])
        if (x <= 0).any():
            return self.rays
        count, turn = self.rays.shape[1], float(np.arctan2(middle[1], middle[0]))
        step = 2 * np.pi / count
        at = (np.array([np.arctan2(y, x).min(), np.arctan2(y, x).max()]) + turn + np.pi) / step
        return self.rays[:, np.arange(int(at[0]), int(at[1]) + 2) % count]


def ring_rays(points: Sequence[Array]) -> RayGrid:
    """Return the rays of a spinning or a 2D LiDAR, of the rings on which it saw a pattern.

    Args:
        points: (N, 3) of each view.
    """
    together = np.concatenate(points)
    polar = np.arctan2(np.hypot(together[:, 0], together[:, 1]), together[:, 2])
    order = np.argsort(polar)
    rings = [each.mean() for each in np.split(polar[order], np.flatnonzero(np.diff(polar[order]) > RING_GAP) + 1)]
    steps = []
    for each in points:
        own = np.arctan2(np.hypot(each[:, 0], each[:, 1]), each[:, 2])
        azimuths = np.arctan2(each[:, 1], each[:, 0])
        order = np.lexsort((azimuths, np.round(own / RING_GAP)))
        gaps = np.diff(azimuths[order])
        steps.append(gaps[gaps > 0])
    step = max(float(np.median(np.concatenate(steps))), 2 * np.pi / 20_000)
    azimuth = np.arange(-np.pi, np.pi, step)
    sin, cos = np.sin(rings)[:, None], np.cos(rings)[:, None]
    flat = np.broadcast_to(cos, (len(rings), len(azimuth)))
    return RayGrid(np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), flat], -1), has_border=True)


def _pixel_rays(camera: Camera, points: Sequence[Array]) -> RayGrid:
    """Return the rays of a depth camera's pixels, as sparse as the points of its views."""
    areas = [np.ptp(camera.project(each), axis=0).prod() / len(each) for each in points if len(each) > 1]
    step = max(1.0, float(np.median(areas)) ** 0.5)
    u, v = np.arange(0, camera.width, step), np.arange(0, camera.height, step)
    rays = camera.rays(np.stack(np.meshgrid(u, v), -1))
    return RayGrid(rays / np.linalg.norm(rays, axis=-1, keepdims=True), has_border=False)


def _points(grid: RayGrid, pattern: Pattern, T: Array) -> PointLabels | None:
    """Return the points of a pattern at a pose (4, 4); None if there are too few."""
    outline = apply(T, np.column_stack([pattern.outline, np.zeros(len(pattern.outline))]))
    if grid.leaves_rings(outline):
        return None
    rays = grid.towards(outline)
    distance, hits = meets(pattern, T, rays)
    if np.count_nonzero(hits) < MIN_POINTS:
        return None
    points = (distance[..., None] * rays)[hits]
    row = np.nonzero(hits)[0]
    if not grid.has_border:
        return PointLabels(points, np.zeros(0, int))
    # the points of a row are in the order of their azimuth; where they cross +-180 degrees its ends are in between
    gaps = np.diff(np.arctan2(points[:, 1], points[:, 0]))
    step = float(np.median(np.abs(gaps)))
    ends = np.flatnonzero((np.diff(row) != 0) | (np.abs(gaps) > 2 * step))
    limits = np.unique(np.concatenate([[0], ends, ends + 1, [len(points) - 1]]))
    return PointLabels(points, limits)
