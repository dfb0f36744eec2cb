"""Depth images of a simulated depth camera."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.depth_image import NO_RETURN, UNIT
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array
from calibration.simulation.board import Board
from calibration.simulation.rendering.background import background
from calibration.simulation.rendering.rays import rays, rounded
from calibration.simulation.scene import Scene
from calibration.simulation.sensors import SimulatedDepthCamera


def render_depth(
    sensor: SimulatedDepthCamera,
    T_world_camera: Array,
    scene: Scene,
    boards: Sequence[Board],
    random: np.random.Generator,
) -> NDArray[np.uint16]:
    """What a depth camera measures: (height, width), along the optical axis, in units of `UNIT`.

    Each pixel measures the nearest surface at its centre. `NO_RETURN` where there is none, or out of
    range, or farther than 16 bits reach.

    Args:
        sensor: the depth camera.
        T_world_camera: (4, 4), to its optical frame.
        scene: what stands around.
        boards: the patterns.
        random: gives one number for each pixel, whatever it sees.
    """
    noise = random.standard_normal((sensor.camera.height, sensor.camera.width), dtype=np.float32)
    pose = rounded(T_world_camera)
    depth = background(sensor.camera, pose, scene).depth
    directions = rays(sensor.camera)[:, 1:-1, 1:-1]
    for board in boards:
        T_camera_pattern = inverse(pose) @ rounded(board.T_world_pattern)
        depth = np.minimum(depth, board.cast_in(T_camera_pattern, directions))
    in_range = (depth >= sensor.least_range) & (depth <= sensor.most_range)
    depth = np.where(in_range, depth, 0.0)
    measured = depth + (sensor.noise + sensor.noise_growth * depth**2) * noise
    counts = np.rint(measured / UNIT)
    return np.where(in_range & (counts >= 0) & (counts < NO_RETURN), counts, NO_RETURN).astype(np.uint16)
