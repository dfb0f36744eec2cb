"""Detection of a pattern in a depth image: its pixels on the pattern, and those on its border."""

import cv2
import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.sensor_data import DEPTH_UNIT_M, NO_RETURN
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.detection import DepthImage, NotDetected
from calibration.robot.labelling.points import (
    BORDER_END_M,
    BORDER_SLACK_M,
    DEFAULT_TOLERANCE_M,
    LEAST_POINTS,
    PatternPoints,
    find_board,
)

MAX_SEARCHED_PIXELS = 5000
"""Approximate number of pixels that the plane is searched in."""
EDGE_SHARE = 0.025
"""Margin of the image, as a fraction of width and height, in which no pixel is on a border (ATOM's rule)."""
AROUND_PATTERN_M = 0.1
"""m: margin of the searched region around the pattern's expected position."""


def label_depth(
    depth: DepthImage,
    camera: Camera,
    pattern: Pattern,
    T_sensor_pattern: Array,
    tolerance: float = DEFAULT_TOLERANCE_M,
    most: int | None = 5000,
) -> PatternPoints | NotDetected:
    """Find the pixels of a depth image on a pattern: the largest connected region on its plane, at its position.

    A pixel of the region is on the border if the neighbouring pixel is behind the board or has no depth, it is
    not well inside of the estimated border, and it is not near the edge of the image. An occluded part has no
    border.

    Args:
        depth: (H, W), tenths of a millimetre along the optical axis; 65535 (and 0) without a return.
        camera: its intrinsics.
        pattern: its geometry.
        T_sensor_pattern: (4, 4), expected pose of the pattern, such as from another camera and an initial guess.
        tolerance: limit of the distance of any point of the board from its expected position, m.
        most: limit of the number of pixels of the region, and of the border, evenly thinned. None for all.

    Returns:
        Linear indices ``y * width + x``.
    """
    part = _part_with_pattern(depth.shape, camera, pattern, T_sensor_pattern, tolerance)
    rays = _pixel_directions(camera, part)
    points = rays * _depth_in_metres(depth[part])[..., None]
    flat = points.reshape(-1, 3)
    step = int(np.ceil(np.sqrt(max(1, len(flat) / MAX_SEARCHED_PIXELS))))
    board = find_board(points[::step, ::step].reshape(-1, 3), pattern.outline, T_sensor_pattern, tolerance)
    if isinstance(board, NotDetected):
        return board
    crossing = board.crossing(rays.reshape(-1, 3))
    inside, behind = board.inside(crossing), board.behind(flat)
    if reason := board.absent(behind, inside, sure=tolerance / 4):
        return NotDetected(reason)
    region = _largest_part((board.on_plane(flat) & (inside > -BORDER_SLACK_M)).reshape(points.shape[:2]))
    if region.sum() < LEAST_POINTS:
        return NotDetected(f"{region.sum()} points on the pattern, at least {LEAST_POINTS} are needed")
    beyond = (board.passed(behind) | np.isnan(behind)).reshape(region.shape)
    at_end = (inside < BORDER_END_M + 2 * _ray_spacing(crossing, region.shape)).reshape(region.shape)
    beside = cv2.dilate((beyond & ~region).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
    border = region & beside & at_end & away_from_edge(depth.shape, *np.mgrid[part])
    numbers = np.arange(depth.size).reshape(depth.shape)[part]
    border = _thin_region(border, most)
    return PatternPoints(numbers[_thin_region(region, most) | border], numbers[border])


def _part_with_pattern(
    shape: tuple[int, ...], camera: Camera, pattern: Pattern, T_sensor_pattern: Array, tolerance: float
) -> tuple[slice, slice]:
    """Return the part of the image in which the pattern may be; the whole image if it may be behind the camera."""
    reach = tolerance + AROUND_PATTERN_M
    low, high = pattern.outline.min(axis=0) - reach, pattern.outline.max(axis=0) + reach
    corners = np.stack(np.meshgrid([low[0], high[0]], [low[1], high[1]], [-tolerance, tolerance]), -1).reshape(-1, 3)
    pixels, visible = camera.project_visible(apply(T_sensor_pattern, corners))
    if not visible.all():
        return slice(0, shape[0]), slice(0, shape[1])
    (left, top), (right, bottom) = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    rows = np.clip([top, bottom + 1], 0, shape[0]).astype(int)
    columns = np.clip([left, right + 1], 0, shape[1]).astype(int)
    return slice(*rows.tolist()), slice(*columns.tolist())


def _pixel_directions(camera: Camera, part: tuple[slice, slice]) -> Array:
    """Directions (h, w, 3) of the pixels of a part of the image, (x, y, 1)."""
    v, u = np.mgrid[part].astype(float)
    return np.concatenate([camera.normalise(np.stack([u, v], -1)), np.ones((*u.shape, 1))], -1)


def _depth_in_metres(depth: DepthImage) -> Array:
    """Convert depths to metres; NaN without a return."""
    return np.where((depth == NO_RETURN) | (depth == 0), np.nan, depth * DEPTH_UNIT_M)


def _largest_part(region: BoolArray) -> BoolArray:
    """Return the largest part of a region (h, w) that is connected by the pixels' sides."""
    count, parts, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=4)
    if count < 2:
        return region
    largest: BoolArray = parts == 1 + int(np.array(stats)[1:, cv2.CC_STAT_AREA].argmax())
    return largest


def _ray_spacing(crossing: Array, shape: tuple[int, int]) -> Array:
    """Distance (h * w,) between the intersections of neighbouring pixels' rays with the plane, m."""
    grid = crossing.reshape(*shape, 2)
    down = np.linalg.norm(np.diff(grid, axis=0, append=grid[-1:]), axis=-1)
    right = np.linalg.norm(np.diff(grid, axis=1, append=grid[:, -1:]), axis=-1)
    spacing: Array = np.maximum(down, right).ravel()
    return spacing


def away_from_edge(shape: tuple[int, ...], v: IntArray, u: IntArray) -> BoolArray:
    """Return a mask of pixels at rows v and columns u of an image (H, W) that are not near the image's edge."""
    near = (np.minimum(v, shape[0] - 1 - v) < EDGE_SHARE * shape[0]) | (
        np.minimum(u, shape[1] - 1 - u) < EDGE_SHARE * shape[1]
    )
    return ~near


def _thin_region(region: BoolArray, most: int | None) -> BoolArray:
    """Thin a region (h, w) evenly to at most this number of pixels."""
    chosen = np.flatnonzero(region)
    step = 1 if most is None else max(1, -(-len(chosen) // most))
    thinned = np.zeros(region.size, bool)
    thinned[chosen[::step]] = True
    return thinned.reshape(region.shape)
