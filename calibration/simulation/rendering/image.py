"""Radiance of a camera's image: patterns in front of the background.

The brightness of pixels that see only one pattern is computed by `calibration.simulation.rendering.pattern_view`. At
edges, of a pattern or of an occluder, every sample of a pixel is cast separately to find the share of each
surface in the pixel.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array, IntArray
from calibration.simulation.board import Board
from calibration.simulation.rendering.background import STEPS, Background, background, colours
from calibration.simulation.rendering.pattern_view import PatternView, pattern_view
from calibration.simulation.rendering.rays import SAMPLES, rounded, sample_rays
from calibration.simulation.scene import Scene, turned


def radiance(camera: Camera, T_world_camera: Array, scene: Scene, boards: Sequence[Board]) -> NDArray[np.uint16]:
    """Render the image of a camera: (height, width, 3) in blue, green, red, in `STEPS` of a grey level.

    Args:
        camera: its intrinsics.
        T_world_camera: (4, 4), to its optical frame.
        scene: the surroundings, and the light.
        boards: the patterns.

    Raises:
        InputError: a pattern cannot be printed (see `calibration.simulation.rendering.texture.texture`).
    """
    pose = rounded(T_world_camera)
    behind = background(camera, pose, scene)
    views = [view for board in boards if (view := pattern_view(camera, pose, board, scene.light))]
    return _composed(camera, pose, scene, behind, views)


def _composed(
    camera: Camera, T_world_camera: Array, scene: Scene, behind: Background, views: list[PatternView]
) -> NDArray[np.uint16]:
    """Combine background and patterns to the radiance (height, width, 3)."""
    light, nearest = behind.radiance.copy(), behind.depth.copy()
    owner = np.zeros(nearest.shape, np.uint16)  # 0 for the background
    several = np.zeros(nearest.shape, bool)
    for i, view in enumerate(views):
        nearer = view.depth < nearest[view.part]
        nearest[view.part][nearer], owner[view.part][nearer] = view.depth[nearer], i + 1
        several[view.part] |= view.border
    for i, view in enumerate(views):
        np.copyto(light[view.part], view.radiance[..., None], where=(owner[view.part] == i + 1)[..., None])
    if views:
        # a pixel that is crossed by an edge has another owner than one of its four neighbours
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
        several |= cv2.dilate(owner, cross) != cv2.erode(owner, cross)
        rows, columns = np.nonzero(several)
        if len(rows):
            light[rows, columns] = _mixed(camera, T_world_camera, scene, views, rows, columns)
    return light


def _mixed(
    camera: Camera, T_world_camera: Array, scene: Scene, views: list[PatternView], rows: IntArray, columns: IntArray
) -> NDArray[np.uint16]:
    """Return the radiance (N, 3) of pixels that see several surfaces."""
    directions, origin = sample_rays(camera, rows, columns), T_world_camera[:3, 3]
    world = turned(T_world_camera, directions)
    nearest, surface = scene.hit(origin, world)
    owner = np.zeros(nearest.shape, np.int64)
    total = np.zeros((len(rows), 3))
    for i, view in enumerate(views):
        distance = view.board.cast_in(view.T_camera_pattern, directions)
        nearer = distance < nearest
        nearest[nearer], owner[nearer] = distance[nearer], i + 1
    for i, view in enumerate(views):
        share = (owner == i + 1).mean(axis=1)
        seen_by = np.flatnonzero(share)
        (top, left), (height, width) = (part.start for part in view.part), view.radiance.shape
        row, column = np.clip(rows[seen_by] - top, 0, height - 1), np.clip(columns[seen_by] - left, 0, width - 1)
        total[seen_by] += (share[seen_by] * view.radiance[row, column])[:, None]
    pixel, sample = np.nonzero(owner == 0)
    seen = colours(scene, origin, world[:, pixel, sample], nearest[pixel, sample], surface[pixel, sample])
    for channel in range(3):
        total[:, channel] += np.bincount(pixel, seen[:, channel], len(rows)) * (STEPS / SAMPLES)
    return np.rint(np.minimum(total, 65535)).astype(np.uint16)
