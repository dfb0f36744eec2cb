"""Radiance of a camera's image: patterns in front of the background.

The brightness of pixels that see only one pattern is computed by `rendering.pattern_view`. At
edges, of a pattern or of an occluder, every sample of a pixel is cast separately to find the share of each
surface in the pixel.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.rendering.background import STEPS_PER_GREY_LEVEL, Background, background
from calibration.robot.simulation.rendering.pattern_view import PatternView, pattern_view
from calibration.robot.simulation.rendering.rays import SAMPLES_PER_PIXEL, rounded, sample_rays
from calibration.robot.simulation.scene import Scene, turned


def radiance(camera: Camera, T_world_camera: Array, scene: Scene, boards: Sequence[Board]) -> NDArray[np.uint16]:
    """Render the image of a camera: (height, width, 3) in blue, green, red, in `STEPS_PER_GREY_LEVEL` of a grey level.

    Args:
        camera: its intrinsics.
        T_world_camera: (4, 4), to its optical frame.
        scene: the surroundings, and the light.
        boards: the patterns.

    Raises:
        InputError: a pattern cannot be printed (see `calibration.robot.simulation.rendering.texture.texture`).
    """
    pose = rounded(T_world_camera)
    behind = background(camera, pose, scene)
    views = [view for board in boards if (view := pattern_view(camera, pose, board, scene.light))]
    light = behind.radiance.copy()
    if views:
        rows, columns = _draw_patterns(light, behind, views)
        if len(rows):
            light[rows, columns] = _mixed_radiance(camera, pose, scene, behind, views, rows, columns)
    return light


def _draw_patterns(
    light: NDArray[np.uint16], behind: Background, views: list[PatternView]
) -> tuple[IntArray, IntArray]:
    """Draw patterns into the radiance (height, width, 3) of the background.

    Returns:
        The rows and columns of the pixels that see several surfaces.
    """
    window = _slices_around(views, light.shape[:2])
    (top, left), shape = (part.start for part in window), light[window].shape[:2]
    hidden = behind.is_beyond(window, [view.depth for view in views])
    nearest = np.full(shape, np.inf) if hidden else behind.depth[window].copy()
    owner = np.zeros(shape, np.uint16)  # 0 for the background
    several = np.zeros(shape, bool)
    parts = [(_shift_slice(view.part[0], -top), _shift_slice(view.part[1], -left)) for view in views]
    for i, (view, part) in enumerate(zip(views, parts, strict=True)):
        nearer = view.depth < nearest[part]
        np.copyto(nearest[part], view.depth, where=nearer)
        np.copyto(owner[part], i + 1, where=nearer)
        several[part] |= view.border
    for i, (view, part) in enumerate(zip(views, parts, strict=True)):
        np.copyto(light[view.part], view.radiance[..., None], where=(owner[part] == i + 1)[..., None])
    # a pixel that is crossed by an edge has another owner than one of its four neighbours
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    several |= cv2.dilate(owner, cross) != cv2.erode(owner, cross)
    rows, columns = np.nonzero(several)
    return rows + top, columns + left


def _slices_around(views: list[PatternView], size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of patterns in an image of (height, width), with a margin of one pixel."""
    rows, columns = (
        slice(max(0, min(part.start for part in parts) - 1), min(limit, max(part.stop for part in parts) + 1))
        for parts, limit in zip(zip(*(view.part for view in views), strict=True), size, strict=True)
    )
    return rows, columns


def _shift_slice(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)


def _mixed_radiance(
    camera: Camera,
    T_world_camera: Array,
    scene: Scene,
    behind: Background,
    views: list[PatternView],
    rows: IntArray,
    columns: IntArray,
) -> NDArray[np.uint16]:
    """Return the radiance (N, 3) of pixels that see several surfaces."""
    directions = sample_rays(camera, rows, columns)
    distances = [view.board.cast_in(view.T_camera_pattern, directions) for view in views]
    if behind.is_beyond((slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)), distances):
        nearest = np.full(directions.shape[1:], np.inf)
    else:
        nearest, _ = scene.hit(T_world_camera[:3, 3], turned(T_world_camera, directions))
    owner = np.zeros(nearest.shape, np.int64)
    for i, distance in enumerate(distances):
        nearer = distance < nearest
        nearest[nearer], owner[nearer] = distance[nearer], i + 1
    seen = behind.colours(directions, rows, columns)
    seen[:, owner != 0] = 0
    total = np.zeros((len(rows), 3))
    for i, view in enumerate(views):
        share = (owner == i + 1).mean(axis=0)
        seen_by = np.flatnonzero(share)
        (top, left), (height, width) = (part.start for part in view.part), view.radiance.shape
        row, column = np.clip(rows[seen_by] - top, 0, height - 1), np.clip(columns[seen_by] - left, 0, width - 1)
        total[seen_by] += (share[seen_by] * view.radiance[row, column])[:, None]
    total += seen.sum(axis=1).T * (STEPS_PER_GREY_LEVEL / SAMPLES_PER_PIXEL)
    return np.rint(np.minimum(total, 65535)).astype(np.uint16)
