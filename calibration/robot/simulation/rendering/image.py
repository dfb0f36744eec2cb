"""Radiance of a camera's image: patterns in front of the background.

The coordinates on the print of a pattern vary smoothly from pixel to pixel, so they are computed once per pixel, and
extrapolated to its samples by the differences to the neighbours. At edges, of a pattern or of an occluder, every sample
of a pixel is cast separately to find the share of each surface in the pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.model import IN_FRONT
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.simulation.rendering.background import (
    SAMPLES_PER_PIXEL,
    STEPS_PER_GREY_LEVEL,
    Background,
    background,
    in_steps,
    rays,
    rounded,
    sample_rays,
)
from calibration.robot.simulation.rendering.texture import texture
from calibration.robot.simulation.scene import Board, Light, Scene, turned

BACK_REFLECTANCE = 150.0
"""Reflectance of the back of a board, in grey levels under a light of 1."""
_SAMPLES_PER_SIDE = 4
"""Samples of a pixel along each side: texels are about as wide as their distance, so that they leave no gaps."""
_SAMPLE_OFFSETS = tuple(
    product(
        (np.arange(_SAMPLES_PER_SIDE, dtype=np.float32) + np.float32(0.5)) / _SAMPLES_PER_SIDE - np.float32(0.5),
        repeat=2,
    )
)
"""(y, x) of the samples from the pixel's centre, px."""
_PIXEL_REACH = 0.55
"""Reach of a pixel from its centre, in pixels; slightly more than half, because surfaces are curved."""
_PIXELS_PER_BATCH = 16_000
"""Approximate number of pixels per batch, which fit into the cache."""
_PIXELS_PER_RESOLUTION = 16
"""Number of rows or columns of pixels that share a resolution."""
_MAX_TEXEL_COORDINATE = 16_000.0
"""Limit of texel coordinates: beyond it there is no texture, and twice the value still fits into 16 bits."""


@dataclass(frozen=True, eq=False)
class PatternView:
    """View of a pattern in a part of an image, (h, w)."""

    board: Board
    T_camera_pattern: Array
    part: tuple[slice, slice]
    """Rows and columns of the image."""
    depth: Array
    """Distance along the rays of the pixels' centres, to the front the depth, m; infinite outside of the pattern."""
    border: BoolArray
    """Mask of the pixels that the pattern covers partially."""
    radiance: NDArray[np.uint16]
    """Radiance in steps of a grey level, as if the pattern filled every pixel."""


def pattern_view(camera: Camera, T_world_camera: Array, board: Board, light: Light) -> PatternView | None:
    """Render a pattern for a camera; None if it is not in the image. A bowed board is lit like a flat one."""
    T_camera_pattern = inverse(T_world_camera) @ rounded(board.T_world_pattern)
    part = _slices_of_pattern(camera, T_camera_pattern, board)
    if part is None:
        return None
    rows, columns = part
    around = rays(camera)[:, rows.start : rows.stop + 2, columns.start : columns.stop + 2]
    T_pattern_camera = inverse(T_camera_pattern)
    shape = around.shape[1] - 2, around.shape[2] - 2
    depth, border, radiance = np.full(shape, np.inf), np.zeros(shape, bool), np.zeros(shape, np.uint16)
    coarse = max(1, min(shape) // _PIXELS_PER_RESOLUTION)
    spacing = _Pixels.of(board, T_pattern_camera, around[:, ::coarse, ::coarse]).spacing(board) / coarse
    normal = -board.T_world_pattern[:3, 2]
    front, back = np.float32(light.on(normal)), in_steps(np.array(BACK_REFLECTANCE * light.on(-normal)))
    step = max(1, _PIXELS_PER_BATCH // shape[1])
    for row in range(0, shape[0], step):
        strip = slice(row, row + step)
        pixels = _Pixels.of(board, T_pattern_camera, around[:, row : row + step + 2])
        inside, touched, whole = pixels.on(board)
        depth[strip][inside], border[strip] = pixels.depth[inside], touched & ~whole
        used = np.flatnonzero(touched.any(axis=0))
        if len(used):
            some = slice(used[0], used[-1] + 1)
            lit = in_steps(_sample_print(board, pixels.columns(some), spacing) * front)
            radiance[strip, some] = np.where(pixels.shows_print[:, some], lit, back)
    return PatternView(board, T_camera_pattern, part, depth, border, radiance)


def _slices_of_pattern(camera: Camera, T_camera_pattern: Array, board: Board) -> tuple[slice, slice] | None:
    """Return the rows and columns around a pattern: all if it is near the camera's plane or the limit of the lens."""
    low, high = board.limits
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 9).T), -1).reshape(-1, 2)
    points = apply(T_camera_pattern, board.surface(grid))
    if camera.distortion.chart is IN_FRONT and points[:, 2].max() <= 0:
        return None
    pixels, visible = camera.project_visible(points)
    first, last = np.zeros(2), np.array([camera.width, camera.height]) - 1.0
    if visible.all():
        margin = 2 + 0.02 * np.ptp(pixels, axis=0)  # the border is slightly curved between the points
        first = np.maximum(first, np.floor(pixels.min(axis=0) - margin))
        last = np.minimum(last, np.ceil(pixels.max(axis=0) + margin))
    if (first > last).any():
        return None
    (left, top), (right, bottom) = first.astype(int).tolist(), last.astype(int).tolist()
    return slice(top, bottom + 1), slice(left, right + 1)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Intersections of pixels (h, w) with the infinite sheet of a board; NaN without an intersection."""

    depth: Array
    """Distance along the rays of their centres, as of `PatternView`; below 0 behind the camera."""
    xy: Array
    """(2, h, w): intersections of their centres, in the pattern frame."""
    to_right: Array
    """(2, h, w): difference of x and y to the next pixel on the right."""
    down: Array
    """(2, h, w): difference to the next pixel below."""
    shows_print: BoolArray
    """Whether the printed side is visible."""

    @classmethod
    def of(cls, board: Board, T_pattern_camera: Array, around: Array) -> "_Pixels":
        """Intersect the rays (3, h + 2, w + 2) of the pixels and of a margin of one on each side."""
        start, directions = T_pattern_camera[:3, 3], turned(T_pattern_camera, around)
        depth = board.meet(start, directions)
        with np.errstate(invalid="ignore", over="ignore"):
            xy = start[:2, None, None] + depth * directions[:2]
            to_right, down = (xy[:, 1:-1, 2:] - xy[:, 1:-1, :-2]) / 2, (xy[:, 2:, 1:-1] - xy[:, :-2, 1:-1]) / 2
        depth, directions = depth[1:-1, 1:-1], directions[:, 1:-1, 1:-1]
        return cls(depth, xy[:, 1:-1, 1:-1], to_right, down, board.shows_print(start, directions, depth))

    def columns(self, some: slice) -> "_Pixels":
        """Return a range of columns."""
        cut = (self.depth[:, some], self.xy[..., some], self.to_right[..., some], self.down[..., some])
        return _Pixels(*cut, self.shows_print[:, some])

    def on(self, board: Board) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Return masks (h, w) of pixels with their centre on the board, partially on it, completely on it."""
        low, high = (limit[:, None, None] for limit in board.limits)
        with np.errstate(invalid="ignore", over="ignore"):
            reach = _PIXEL_REACH * (np.abs(self.to_right) + np.abs(self.down))
            reach[np.isnan(reach)] = np.inf
            beyond = np.maximum(low - self.xy, self.xy - high)  # distance beyond the nearer side
            in_front = self.depth > 0
            inside: BoolArray = (beyond <= 0).all(axis=0) & in_front
            touched: BoolArray = (beyond <= reach).all(axis=0) & in_front
            whole = np.asarray((beyond <= -reach).all(axis=0))
        return inside, touched, whole

    def spacing(self, board: Board) -> float:
        """Return the median distance of neighbouring pixels on the board, along the steeper axis of the image, m."""
        _, touched, _ = self.on(board)
        with np.errstate(over="ignore"):
            squares = np.maximum((self.to_right**2).sum(axis=0), (self.down**2).sum(axis=0))[touched]
        known = squares[np.isfinite(squares)]
        return float(np.sqrt(np.median(known))) if len(known) else 0.0


def _sample_print(board: Board, pixels: _Pixels, spacing: float) -> NDArray[np.float32]:
    """Return the print (h, w) averaged over the samples of each pixel, in grey levels under a light of 1.

    Args:
        board: the board.
        pixels: their intersections with the board.
        spacing: distance of two pixels on the board, m: the samples of all pixels have the same resolution.
    """
    ink, size = texture(board.configuration, board.legacy_layout), board.configuration.size
    level = ink.level(spacing / _SAMPLES_PER_SIDE / size * ink.texels)
    offset, scale = ink.place(board.pattern, size, level)
    centre, right, below = (
        _as_texels(pixels.xy, scale, offset),
        _as_texels(pixels.to_right, scale),
        _as_texels(pixels.down, scale),
    )
    total = np.zeros(pixels.depth.shape, np.uint16)
    for y, x in _SAMPLE_OFFSETS:
        places = centre + y * below + x * right
        # integers from here on, so that all machines compute the same
        whole, fraction = cv2.convertMaps(places, np.empty(0), cv2.CV_16SC2)
        sample = cv2.remap(ink.levels[level], whole, fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        total += np.asarray(sample, np.uint8)
    return total * np.float32(1 / len(_SAMPLE_OFFSETS))


def _as_texels(values: Array, scale: float, offset: Array | None = None) -> NDArray[np.float32]:
    """Convert lengths on the board (2, h, w), m, to texels (h, w, 2); 0 if they are unknown."""
    texels = np.empty((*values.shape[1:], 2), np.float32)
    with np.errstate(over="ignore"):
        for axis in range(2):
            texels[..., axis] = scale * values[axis] + (0.0 if offset is None else offset[axis])
    np.clip(texels, -_MAX_TEXEL_COORDINATE, _MAX_TEXEL_COORDINATE, out=texels)
    texels[np.isnan(texels)] = 0
    return texels


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
            light[rows, columns] = _mixed_radiance(camera, behind, views, rows, columns)
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
    nearest = behind.depth[window].copy()
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
    camera: Camera, behind: Background, views: list[PatternView], rows: IntArray, columns: IntArray
) -> NDArray[np.uint16]:
    """Return the radiance (N, 3) of pixels that see several surfaces."""
    directions = sample_rays(camera, rows, columns)
    distances = [view.board.cast_in(view.T_camera_pattern, directions) for view in views]
    nearest, seen = behind.along(directions)
    owner = np.zeros(nearest.shape, np.int64)
    for i, distance in enumerate(distances):
        nearer = distance < nearest
        nearest[nearer], owner[nearer] = distance[nearer], i + 1
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
