"""The same bytes on processors of other kinds, whose vectors are wider or narrower."""

import hashlib

import numpy as np

from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar
from tests.processors import on_a_lesser_processor, on_linux
from tests.robot.simulation.rendering.views import CHARUCO, DISTORTION, T_WORLD_CAMERA, board, camera, random_pose


def digest() -> str:
    """Of an image, a depth image and a scan."""
    random, seen = np.random.default_rng(9), hashlib.sha256()
    box = Box(T_WORLD_CAMERA @ np.diag([1.0, 1, 1, 1]), np.array([0.1, 0.2, 0.3]))
    box.T_world_box[:3, 3] += [0.8, 0.1, 0.1]
    scene = Scene(ground=0.0, boxes=(box,))
    for distortion, bow in ((None, (0.0, 0.0)), (DISTORTION, (0.01, 0.02))):
        of = camera(distortion=distortion)
        boards = [board(random_pose(random, CHARUCO, 0.9, 1.2), bow=bow)]
        seen.update(SimulatedCamera(of).render(T_WORLD_CAMERA, scene, boards, stream(1)).tobytes())
        seen.update(SimulatedDepthCamera(of).render(T_WORLD_CAMERA, scene, boards, stream(1)).tobytes())
        lidar = SimulatedLidar((-0.1, 0.0, 0.1), 500)
        seen.update(lidar.scan(T_WORLD_CAMERA, scene, boards, stream(1)).ranges.tobytes())
    return seen.hexdigest()


@on_linux
def test_a_lesser_processor_makes_the_same_bytes() -> None:
    assert on_a_lesser_processor(__name__, "digest()") == digest()
