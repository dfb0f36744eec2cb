"""What the sensors see of a pattern at each pose of a motion: whether a detector would find it, and where.

A detector finds a corner by the squares around it, so a corner counts as seen where its four squares
are on the image, large enough, with nothing before them. Ours finds nearly all of these, and some more.
"""

from dataclasses import dataclass

import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.pattern import Pattern, grid
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array, BoolArray
from calibration.labelling.cut import cut_ends
from calibration.simulation.placement import Placement
from calibration.simulation.system import System
from calibration.simulation.visibility import MAX_VIEW_ANGLE, corners_in_image, facing

CELLS = (4, 3)
"""An image's columns and rows of cells: a motion shows the pattern's corners in each."""
LEAST_SHARE = 0.5
"""Of the corners: a view of fewer says little, and a detector may miss it."""
LEAST_SQUARE = 14.0
"""The width of a square in the image, px. At 12 our detector finds 98 % of the corners (markers of 7 bits
on 3/4 of a square, blur 0.65 px), at 10 it finds 60 %."""
LEAST_RINGS = 4
"""Of a LiDAR that cross the pattern."""
LEAST_CUT = 0.5
"""The length of a 2D LiDAR's cut, in the pattern's smaller side: a corner cut off says little."""


@dataclass(frozen=True, eq=False)
class CameraViews:
    """The K corners of a pattern in a camera's images at N poses."""

    pixels: Array
    """(N, K, 2); NaN behind the camera."""
    seen: BoolArray
    """(N, K): those that are surely found."""
    partial: BoolArray
    """(N,): some corners are off the image or hidden."""
    detectable: BoolArray
    """(N,): enough corners, from in front."""

    def cells(self, camera: Camera) -> BoolArray:
        """In which cells (N, columns * rows) of the image there is a corner."""
        columns, rows = CELLS
        with np.errstate(invalid="ignore"):
            place = (self.pixels + 0.5) / [camera.width, camera.height] * CELLS
        column, row = np.moveaxis(np.where(self.seen[..., None], place, -1).astype(int), -1, 0)
        cell = np.where(self.seen, row.clip(max=rows - 1) * columns + column.clip(max=columns - 1), -1)
        occupied: BoolArray = (cell[..., None] == np.arange(columns * rows)).any(-2)
        return occupied


def camera_views(system: System, sensor: str, pattern: str, placement: Placement) -> CameraViews:
    """What a camera of the system sees of a pattern at the poses of a placement."""
    camera = system.cameras[sensor].camera
    T_camera_pattern = placement.pattern_in(sensor, pattern)
    squares = square_corners(system.configuration.patterns[pattern], system.patterns[pattern])
    rows, columns = squares.shape[:2]
    pixels, visible = corners_in_image(camera, apply(T_camera_pattern, squares.reshape(-1, 3)))
    in_world = apply(placement.patterns[pattern], squares.reshape(-1, 3))
    visible &= ~system.scene.hides(placement.sensors[sensor][:, :3, 3], in_world)
    pixels, visible = pixels.reshape(-1, rows, columns, 2), visible.reshape(-1, rows, columns)
    with np.errstate(invalid="ignore"):
        clear = _all_four(visible) & (_widths(pixels) >= LEAST_SQUARE)
    seen = _all_four(clear).reshape(len(clear), (rows - 2) * (columns - 2))
    share = 1.0 if system.patterns[pattern].kind == "chessboard" else LEAST_SHARE  # one is found whole or not at all
    front = facing(T_camera_pattern, system.patterns[pattern].centre)
    return CameraViews(
        pixels=pixels[:, 1:-1, 1:-1].reshape(*seen.shape, 2),
        seen=seen,
        partial=~np.all(visible[:, 1:-1, 1:-1], axis=(1, 2)),
        detectable=front & (seen.mean(-1) >= share),
    )


def square_corners(configuration: PatternConfiguration, pattern: Pattern) -> Array:
    """(rows + 2, columns + 2, 3): the corners of all squares, the pattern's (rows, columns) of them inside."""
    (columns, rows), square = configuration.dimension, configuration.size
    x, y = pattern.corners[0, :2] - square
    return grid(columns + 2, rows + 2, square, (float(x), float(y))).reshape(rows + 2, columns + 2, 3)


def _all_four(of: BoolArray) -> BoolArray:
    """Which places (N, R - 1, C - 1) between the nodes of a grid (N, R, C) have all four nodes around them."""
    return of[:, :-1, :-1] & of[:, :-1, 1:] & of[:, 1:, :-1] & of[:, 1:, 1:]


def _widths(pixels: Array) -> Array:
    """(N, R - 1, C - 1): the width of each square with corners (N, R, C, 2), its area over its longer side, px."""
    along = pixels[:, :-1, 1:] - pixels[:, :-1, :-1]
    down = pixels[:, 1:, :-1] - pixels[:, :-1, :-1]
    area = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    longer = np.maximum(np.hypot(*np.moveaxis(along, -1, 0)), np.hypot(*np.moveaxis(down, -1, 0)))
    width: Array = area / np.maximum(longer, 1e-300)
    return width


def centred(system: System, placement: Placement) -> BoolArray:
    """At which poses (N,) a pattern's centre is on every camera's image and turned to it: few others are seen."""

    def shown(camera: str, pattern: str) -> BoolArray:
        T_camera_pattern, centre = placement.pattern_in(camera, pattern), system.patterns[pattern].centre
        _, visible = corners_in_image(system.cameras[camera].camera, apply(T_camera_pattern, centre[None]))
        return visible[:, 0] & facing(T_camera_pattern, centre)

    found: BoolArray = np.all(
        [np.any([shown(camera, pattern) for pattern in system.patterns], axis=0) for camera in system.cameras], axis=0
    )
    return found


def lidar_detects(system: System, sensor: str, pattern: str, placement: Placement) -> BoolArray:
    """At which poses (N,) the rings of a LiDAR cross a pattern well, judged by the pattern's corners."""
    lidar = system.lidars[sensor]
    T_lidar_pattern = placement.pattern_in(sensor, pattern)
    board = system.patterns[pattern]
    corners = apply(T_lidar_pattern, board.corners)
    border = np.linalg.norm(apply(T_lidar_pattern, np.column_stack([board.outline, np.zeros(4)])), axis=-1)
    elevation = np.arcsin(corners[..., 2] / np.linalg.norm(corners, axis=-1))
    rings = np.array(lidar.elevations)
    between = (rings > elevation.min(-1, keepdims=True)) & (rings < elevation.max(-1, keepdims=True))
    sight = corners.mean(-2) / np.linalg.norm(corners.mean(-2), axis=-1, keepdims=True)
    crossed: BoolArray = (
        (between.sum(-1) >= LEAST_RINGS)
        & (border.min(-1) > lidar.least_range)
        & (border.max(-1) < lidar.most_range)
        & (np.abs((T_lidar_pattern[:, :3, 2] * sight).sum(-1)) > np.cos(MAX_VIEW_ANGLE))  # from either side
        & (_hidden(system, sensor, pattern, placement).mean(-1) < 1 - LEAST_SHARE)
    )
    return crossed


def lidar2d_detects(system: System, sensor: str, pattern: str, placement: Placement) -> BoolArray:
    """At which poses (N,) a 2D LiDAR cuts a pattern well."""
    lidar, board = system.lidars2d[sensor], system.patterns[pattern]
    T_lidar_pattern = placement.pattern_in(sensor, pattern)
    ends = cut_ends(board, T_lidar_pattern)
    with np.errstate(invalid="ignore"):
        length, distance = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), np.linalg.norm(ends, axis=-1)
        after_first = np.mod(np.arctan2(ends[..., 1], ends[..., 0]) - lidar.angle_min, 2 * np.pi)
        within = (after_first > lidar.step) & (after_first < lidar.angle_max - lidar.angle_min - lidar.step)
        nearest = np.abs(ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]) / length  # the line's distance
        middle = np.linalg.norm(ends.mean(1), axis=-1)
        cut: BoolArray = (
            (length > LEAST_CUT * np.ptp(board.outline, axis=0).min())
            & (nearest > lidar.least_range)
            & (distance.max(-1) < lidar.most_range)
            & within.all(-1)
            & (nearest > np.cos(MAX_VIEW_ANGLE) * middle)
            & (_hidden(system, sensor, pattern, placement).mean(-1) < 1 - LEAST_SHARE)
        )
    return cut


def depth_camera_detects(system: System, sensor: str, pattern: str, placement: Placement) -> BoolArray:
    """At which poses (N,) a depth camera measures enough of a pattern, judged by the pattern's corners."""
    depth_camera, board = system.depth_cameras[sensor], system.patterns[pattern]
    T_camera_pattern = placement.pattern_in(sensor, pattern)
    corners = apply(T_camera_pattern, board.corners)
    _, visible = corners_in_image(depth_camera.camera, corners)
    visible &= (corners[..., 2] > depth_camera.least_range) & (corners[..., 2] < depth_camera.most_range)
    visible &= ~_hidden(system, sensor, pattern, placement)
    measured: BoolArray = facing(T_camera_pattern, board.centre) & (visible.mean(-1) >= LEAST_SHARE)
    return measured


def _hidden(system: System, sensor: str, pattern: str, placement: Placement) -> BoolArray:
    """Which corners (N, K) of a pattern have something between them and a sensor."""
    corners = apply(placement.patterns[pattern], system.patterns[pattern].corners)
    return system.scene.hides(placement.sensors[sensor][:, :3, 3], corners)
