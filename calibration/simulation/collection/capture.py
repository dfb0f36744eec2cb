"""What the sensors see at one pose of a motion, and what is detected in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.dataset.pattern import Pattern
from calibration.estimation.single_views import corner_term, fitted_poses
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import inverse, translation
from calibration.geometry.types import Array
from calibration.labelling.corners import CornerDetector, corner_detector
from calibration.labelling.depth import label_depth
from calibration.labelling.detection import DepthImage, Image, NotDetected
from calibration.labelling.points import PatternPoints, label_points
from calibration.labelling.scan_line import label_scan_line
from calibration.simulation.board import Board
from calibration.simulation.collection.play import Play
from calibration.simulation.collection.stored_cloud import stored_cloud
from calibration.simulation.collection.stored_scan import scan_points, stored_ranges
from calibration.simulation.random_streams import stream
from calibration.simulation.rendering.depth import render_depth
from calibration.simulation.rendering.image import render_image
from calibration.simulation.rendering.lidar import scan

Key = tuple[str, str]
"""(pattern, sensor)."""


@dataclass(frozen=True, eq=False)
class Capture:
    """The data of every sensor at one pose, and the labels of every pattern in it."""

    number: int
    """Of the pose, from 0."""
    boards: Mapping[str, Sequence[Board]]
    """The patterns as each sensor saw them, in the order of the configuration; a swaying one is elsewhere for each."""
    images: Mapping[str, Image]
    depths: Mapping[str, DepthImage]
    clouds: Mapping[str, Array]
    """(N, 3) in the frame of each 3D LiDAR, m."""
    scans: Mapping[str, Array]
    """(rays,): the ranges of each 2D LiDAR, m; 0 where nothing came back."""
    corners: Mapping[Key, CornerLabels | NotDetected]
    points: Mapping[Key, PatternPoints | NotDetected]
    """Of LiDARs and depth cameras."""
    estimates: Mapping[Key, Array]
    """``T_camera_pattern`` (4, 4) of the detected patterns, each from the labels of that one view."""

    @property
    def movement(self) -> float:
        """How far a pattern was from where another sensor saw it, at most, m."""
        pairs = combinations(self.boards.values(), 2)
        places = (
            (a.T_world_pattern, b.T_world_pattern) for one, other in pairs for a, b in zip(one, other, strict=True)
        )
        return max((float(np.linalg.norm((a - b)[:3, 3])) for a, b in places), default=0.0)


def capture(play: Play, number: int) -> Capture:
    """Let every sensor see one pose, and label what it saw.

    It depends on the play's seed, the number of the pose and the names of the sensors alone, so
    any part of a motion's collections is a part of the whole.
    """
    system, scene = play.system, play.system.scene
    patterns = system.configuration.patterns
    boards = {name: _boards(play, number, name) for name in system.sensors}
    images, depths, clouds, scans = {}, {}, {}, {}
    corners: dict[Key, CornerLabels | NotDetected] = {}
    estimates: dict[Key, Array] = {}
    for name, camera in system.cameras.items():
        random = stream(play.seed, number, name)
        images[name] = render_image(camera, play.true.sensors[name][number], scene, boards[name], random)
        for pattern, configuration in patterns.items():
            found = corners[pattern, name] = _detector(configuration).detect(images[name])
            if isinstance(found, CornerLabels):
                estimates[pattern, name] = estimate_pose(camera.camera, system.patterns[pattern], found)
    points: dict[Key, PatternPoints | NotDetected] = {}
    guesses = {pattern: _guess(play, number, pattern, corners, estimates) for pattern in patterns}
    for name, lidar in system.lidars.items():
        T_world_lidar = play.true.sensors[name][number]
        measured = scan(lidar, T_world_lidar, scene, boards[name], stream(play.seed, number, name))
        clouds[name] = stored_cloud(lidar, measured, boards[name], T_world_lidar)
        T_lidar_world = inverse(play.nominal.sensors[name][number])
        for pattern, T_world_pattern in guesses.items():
            points[pattern, name] = label_points(
                clouds[name], system.patterns[pattern], T_lidar_world @ T_world_pattern
            )
    for name, depth_camera in system.depth_cameras.items():
        random = stream(play.seed, number, name)
        depths[name] = render_depth(depth_camera, play.true.sensors[name][number], scene, boards[name], random)
        T_camera_world = inverse(play.nominal.sensors[name][number])
        for pattern, T_world_pattern in guesses.items():
            points[pattern, name] = label_depth(
                depths[name], depth_camera.camera, system.patterns[pattern], T_camera_world @ T_world_pattern
            )
    for name, lidar2d in system.lidars2d.items():
        T_world_lidar = play.true.sensors[name][number]
        measured = scan(lidar2d, T_world_lidar, scene, boards[name], stream(play.seed, number, name))
        scans[name] = stored_ranges(lidar2d, measured)
        seen = scan_points(lidar2d, scans[name])
        T_lidar_world = inverse(play.nominal.sensors[name][number])
        for pattern, T_world_pattern in guesses.items():
            points[pattern, name] = label_scan_line(seen, system.patterns[pattern], T_lidar_world @ T_world_pattern)
    return Capture(number, boards, images, depths, clouds, scans, corners, points, estimates)


@lru_cache
def _detector(configuration: PatternConfiguration) -> CornerDetector:
    return corner_detector(configuration)


def _boards(play: Play, number: int, sensor: str) -> list[Board]:
    """The patterns where one sensor sees them: the one that is moved may sway."""
    system = play.system
    boards = system.boards({name: T[number] for name, T in play.true.patterns.items()})
    if system.sway and system.moved_pattern:
        offset = system.sway * stream(play.seed, number, sensor, "sway").standard_normal(3)
        moved = system.moved_pattern.name
        return [
            replace(board, T_world_pattern=translation(offset) @ board.T_world_pattern)
            if board.pattern.name == moved
            else board
            for board in boards
        ]
    return boards


def _guess(
    play: Play,
    number: int,
    pattern: str,
    corners: Mapping[Key, CornerLabels | NotDetected],
    estimates: Mapping[Key, Array],
) -> Array:
    """``T_world_pattern`` by the camera that sees most of it; where it was to be if none does.

    As a collector knows it: through the robot as it was designed.
    """
    counts = {
        camera: len(found.ids)
        for (name, camera), found in corners.items()
        if name == pattern and isinstance(found, CornerLabels) and np.isfinite(estimates[name, camera]).all()
    }
    if not counts:
        T_world_pattern: Array = play.nominal.patterns[pattern][number]
        return T_world_pattern
    best = max(counts, key=lambda camera: counts[camera])
    T_world_camera: Array = play.nominal.sensors[best][number]
    return T_world_camera @ estimates[pattern, best]


def estimate_pose(camera: Camera, pattern: Pattern, labels: CornerLabels) -> Array:
    """``T_camera_pattern`` (4, 4) by the labels of one view; NaN where they give none."""
    T_camera_centre, _ = fitted_poses(corner_term(camera, pattern, [labels]))
    T_camera_pattern: Array = T_camera_centre[0] @ inverse(translation(pattern.centre))
    return T_camera_pattern
