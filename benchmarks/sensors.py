"""Simulated sensors of this package beside those of the kept commit: ``python -m benchmarks.sensors``.

It prints CPU times as JSON, in seconds: of an image of a camera that stands, of one in the hand, and of a revolution of
a LiDAR as a collection keeps it. Both packages are measured by the same program, each in processes of its own.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import reference
from benchmarks.process import ENVIRONMENT
from benchmarks.room import PATTERN, ROOM, SMALL, T_WORLD_CAMERA, poses
from benchmarks.shared_data import ROOT
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedLidar

RINGS, AZIMUTHS = 16, 1875
"""Of rlbot's LiDAR."""
RAYS = RINGS * AZIMUTHS


def times(count: int) -> dict[str, float]:
    """CPU seconds of one of each, with the package that this process has."""
    import cv2

    cv2.setNumThreads(1)
    camera, views = SimulatedCamera(SMALL.camera()), poses(count)
    lidar = SimulatedLidar(tuple(np.radians(np.linspace(-15, 15, RINGS))), AZIMUTHS)
    boards = [[Board(PATTERN, PATTERN.pattern(), T_WORLD_CAMERA @ T)] for T in views]
    T_world_lidar = from_xyz_rpy([0, 0.3, 1.2], [0, 0, 0])

    def stands(number: int) -> object:
        return camera.render(T_WORLD_CAMERA, ROOM, boards[number], stream(0, number))

    def in_hand(number: int) -> object:
        T = from_xyz_rpy([0.001 * number, 0, 0], [0, 0, 0]) @ T_WORLD_CAMERA
        return camera.render(T, ROOM, boards[number], stream(0, number))

    def scan(number: int) -> object:
        return lidar.render(T_world_lidar, ROOM, boards[number], stream(0, number))

    return {work.__name__: _each(work, count) for work in (stands, in_hand, scan)}


def _each(work: Callable[[int], object], count: int) -> float:
    work(0)
    seconds = []
    for number in range(count):
        begin = time.process_time()
        work(number)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds))


def measured(count: int, place: Path = ROOT) -> dict[str, float]:
    """The times of `times` in a process with the package in a folder."""
    program = f"sys.path.append({str(ROOT)!r}); from benchmarks.sensors import main; main({count})"
    command = [sys.executable, *reference.python(program, place)]
    done = subprocess.run(command, cwd="/", env=ENVIRONMENT, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main(count: int) -> None:
    """Print the times."""
    print(json.dumps(times(count)))
