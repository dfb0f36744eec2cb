"""Where a depth camera is expected to measure a pattern."""

import numpy as np

from calibration.dataset.model import PointLabels
from calibration.dataset.pattern import Pattern
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array
from calibration.labelling.depth import EDGE
from calibration.simulation.rendering.rays import rays
from calibration.simulation.scene import Scene
from calibration.simulation.sensors import SimulatedDepthCamera

MOST = 5000
"""Pixels on the pattern, about, that are labelled at most, as `calibration.labelling.depth` has it."""


def pixels_on(
    sensor: SimulatedDepthCamera, pattern: Pattern, T_camera_pattern: Array, scene: Scene, T_world_camera: Array
) -> PointLabels:
    """The points of the pixels that see a pattern, evenly thinned, and which have a pixel beside them that does not.

    Args:
        sensor: the depth camera.
        pattern: what it looks at.
        T_camera_pattern: (4, 4).
        scene: what may stand before the pattern.
        T_world_camera: (4, 4).
    """
    camera = sensor.camera
    normal, origin = T_camera_pattern[:3, 2], T_camera_pattern[:3, 3]
    directions = np.moveaxis(rays(camera), 0, -1)  # and one pixel more on every side
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (normal @ origin) / (directions @ normal)
        x, y = np.moveaxis((depth[..., None] * directions - origin) @ T_camera_pattern[:3, :2], -1, 0)
        (left, top), (right, bottom) = pattern.outline.min(0), pattern.outline.max(0)
        hits = (depth > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
        inner = hits[:-2, 1:-1] & hits[2:, 1:-1] & hits[1:-1, :-2] & hits[1:-1, 2:]
    v, u = np.nonzero(hits[1:-1, 1:-1])
    away = (np.minimum(v, camera.height - 1 - v) >= EDGE * camera.height) & (
        np.minimum(u, camera.width - 1 - u) >= EDGE * camera.width
    )
    border = ~inner[v, u] & away
    labelled = border.copy()
    labelled[:: max(1, -(-len(v) // MOST))] = True
    v, u, border = v[labelled], u[labelled], border[labelled]
    points = depth[v + 1, u + 1, None] * directions[v + 1, u + 1]
    seen = (points[:, 2] >= sensor.least_range) & (points[:, 2] <= sensor.most_range)
    seen &= ~scene.hides(T_world_camera[:3, 3], apply(T_world_camera, points))
    return PointLabels(points[seen], np.flatnonzero(border[seen]))
