"""Cameras and boards that the tests of rendering share."""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, PlumbBob
from calibration.engine.geometry.transforms import from_xyz_rpy, transform
from calibration.robot.simulation.scene import Board, Light, Scene
from calibration.robot.simulation.sensors import SimulatedCamera

CHARUCO = PatternConfiguration(
    "pattern_1", "charuco", "pattern", "world", False, (11, 8), 0.06, 0.045, (0.04, 0.03), "DICT_5X5_100"
)
SMALL = PatternConfiguration(
    "small", "charuco", "pattern", "world", False, (4, 5), 0.1, 0.07, (0.02, 0.02), "DICT_4X4_50"
)
CHESSBOARD = PatternConfiguration(
    "pattern_2", "chessboard", "pattern", "world", False, (9, 6), 0.08, None, (0.05, 0.04)
)
APRILGRID = PatternConfiguration(
    "pattern_3", "aprilgrid", "pattern", "world", False, (6, 6), 0.088, None, (0.03, 0.02), APRILGRID_TAGS, spacing=0.3
)
DISTORTION = PlumbBob(-0.25, 0.08, 0.0008, -0.0005, 0.0)
T_WORLD_CAMERA = from_xyz_rpy([0.3, -0.2, 1.2], [-np.pi / 2, 0, -np.pi / 2])
"""Looking along the world's x axis, upright."""
EVEN = Light(ambient=1.0, intensity=0.0)
"""Light under which print has its own brightness."""
DARK = Scene(light=Light(ambient=0.0, intensity=0.0))


def camera(width: int = 320, height: int = 240, focal: float = 300.0, distortion: Distortion | None = None) -> Camera:
    return Camera(focal, focal, width / 2 - 0.5, height / 2 - 0.5, width, height, distortion or PlumbBob())


def perfect(of: Camera) -> SimulatedCamera:
    """A camera that only samples."""
    return SimulatedCamera(of, blur=0.0, noise=0.0, vignetting=0.0)


def board(T_camera_pattern: Array, configuration: PatternConfiguration = CHARUCO, **options: object) -> Board:
    return Board(configuration, configuration.pattern(), T_WORLD_CAMERA @ T_camera_pattern, **options)  # type: ignore[arg-type]


def square_on(configuration: PatternConfiguration, x: float, y: float, z: float) -> Array:
    """``T_camera_pattern`` of a pattern square to the axis, the middle of its border at (x, y, z)."""
    middle = configuration.pattern().outline.mean(axis=0)
    return transform(np.eye(3), [x - middle[0], y - middle[1], z])


def random_pose(
    random: np.random.Generator, configuration: PatternConfiguration, near: float, far: float, tilt: float = 0.7
) -> Array:
    """``T_camera_pattern`` of a pattern about the middle of the image, tilted (rad) and turned."""
    azimuth = random.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    R = rotations.exp(axis * random.uniform(0, tilt)) @ rotations.exp(np.array([0, 0, random.uniform(-0.5, 0.5)]))
    distance = random.uniform(near, far)
    centre = distance * np.array([random.uniform(-0.15, 0.15), random.uniform(-0.1, 0.1), 1.0])
    return transform(R, centre - R @ configuration.pattern().centre)
