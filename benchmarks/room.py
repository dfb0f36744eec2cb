"""Scene of the simulated sensors: a room, a pattern, its poses; and cameras of two sizes."""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import from_xyz_rpy, transform
from calibration.robot.simulation.scene import Box, Scene

PATTERN = PatternConfiguration(
    "pattern_1", "charuco", "pattern", "world", False, (11, 8), 0.06, 0.045, (0.04, 0.03), "DICT_5X5_100"
)
DISTORTION = PlumbBob(-0.25, 0.08, 0.0008, -0.0005, 0.0)
T_WORLD_CAMERA = from_xyz_rpy([0, 0, 1.2], [-np.pi / 2, 0, -np.pi / 2])
ROOM = Scene(
    ground=0.0,
    boxes=(
        Box(from_xyz_rpy([6.0, 0.0, 1.5], [0, 0, 0]), np.array([0.2, 9.0, 3.0])),
        Box(from_xyz_rpy([2.0, 4.5, 1.5], [0, 0, 0]), np.array([8.0, 0.2, 3.0])),
        Box(from_xyz_rpy([4.6, -1.6, 0.5], [0, 0, 0.4]), np.array([0.8, 0.6, 1.0]), (150.0, 90.0, 60.0)),
        Box(from_xyz_rpy([4.2, 1.9, 0.3], [0, 0, -0.7]), np.array([0.6, 0.6, 0.6]), (170.0, 130.0, 80.0)),
    ),
)


@dataclass(frozen=True)
class Size:
    """A camera's size and focal length, px, and how many images a second it should give."""

    width: int
    height: int
    focal: float
    least: float

    def camera(self, distorted: bool = False) -> Camera:
        """The camera, its axis through the middle."""
        cx, cy = self.width / 2 - 0.5, self.height / 2 - 0.5
        lens = DISTORTION if distorted else PlumbBob()
        return Camera(self.focal, self.focal, cx, cy, self.width, self.height, lens)


SMALL, LARGE = Size(640, 480, 550.0, 60.0), Size(1280, 720, 900.0, 20.0)


def poses(count: int) -> list[Array]:
    """``T_camera_pattern`` 1 to 2 m away, tilted up to 40 degrees, turned up to 30."""
    random, found = np.random.default_rng(0), []
    for _ in range(count):
        azimuth, tilt, roll = random.uniform(-1, 1, 3) * [np.pi, np.radians(40), np.radians(30)]
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        R = rotations.exp(tilt * axis) @ rotations.exp(np.array([0, 0, roll]))
        x, y, z = random.uniform([-0.15, -0.1, 1.0], [0.15, 0.1, 2.0])
        centre = np.array([x * z, y * z, z])
        found.append(transform(R, centre - R @ PATTERN.pattern().centre))
    return found
