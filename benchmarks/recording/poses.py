"""Errors of a camera in an arm's hand, by how the arm was moved in front of a board that stands still."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import calibration
from benchmarks.recording.curve import Curve
from benchmarks.room import LARGE, PATTERN
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import RGB
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Edge, Sensor
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, transform

CORNER_NOISE = 0.1
"""Standard deviation of the corners, each axis, px."""
ARM_NOISE_M, ARM_NOISE_RAD = 0.0003, 0.0005
"""Standard deviations of the arm's poses, each axis: those of an industrial arm that is not calibrated itself."""
SPEED = 0.1
"""Speed of the flange, m/s."""
MOUNT: Edge = ("flange", "camera_link")
T_FLANGE_CAMERA = from_xyz_rpy([0.05, -0.03, 0.08], [0.02, -0.05, 1.5])
T_WORLD_BOARD = from_xyz_rpy([0.6, 0.1, 0.2], [0.1, 0.0, 0.4])


@dataclass(frozen=True)
class Recording:
    """Poses of a camera in front of a board."""

    poses: int = 15
    share: float = 0.6
    """Width of the board in that of the image."""
    tilt: float = 40.0
    """Largest angle between the camera's axis and the board's, degrees."""
    roll: float = 90.0
    """Largest turn about the camera's axis, degrees."""
    stamp_error: float = 0.0
    """Largest time between an image and its pose, s, while the flange moves at `SPEED`."""


def curves(seeds: int) -> list[Curve]:
    """Measure each curve with this many recordings a point."""

    def measured(
        name: str,
        title: str,
        of: str,
        x: Sequence[float],
        recommended: tuple[float, float],
        make: Callable[[float], Recording],
    ) -> Curve:
        y = [_error_mm(make(each), seeds) for each in x]
        return Curve(name, title, of, "error of the camera's place, mm", x, y, recommended)

    return [
        measured(
            "poses",
            "Number of poses",
            "poses",
            (4, 5, 6, 8, 10, 15, 20, 30, 45),
            (15, 45),
            lambda x: Recording(poses=int(x)),
        ),
        measured(
            "tilt",
            "Tilt of the board",
            "largest tilt, degrees",
            (5, 10, 15, 20, 30, 40, 50, 60),
            (30, 60),
            lambda x: Recording(tilt=x),
        ),
        measured(
            "roll",
            "Turns about the camera's axis",
            "largest turn, degrees",
            (0, 10, 20, 45, 90, 180),
            (45, 180),
            lambda x: Recording(roll=x),
        ),
        measured(
            "nearness",
            "How near",
            "width of the board / width of the image",
            (0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
            (0.5, 0.8),
            lambda x: Recording(share=x),
        ),
        measured(
            "synchrony",
            f"Synchrony, at {SPEED:g} m/s",
            "largest time between image and pose, ms",
            (0, 2, 5, 10, 20, 40),
            (0, 5),
            lambda x: Recording(stamp_error=1e-3 * x),
        ),
    ]


def _error_mm(recording: Recording, seeds: int) -> float:
    """Return the root mean square of the mount's distance from the truth; infinite where it is not determined."""
    return float(np.sqrt(np.mean([_error_of_one(recording, seed) ** 2 for seed in range(seeds)])))


def _error_of_one(recording: Recording, seed: int) -> float:
    try:
        result = calibration.calibrate(dataset(recording, seed))
    except InputError:
        return float("inf")
    return 1e3 * float(np.linalg.norm(result.transforms[MOUNT][:3, 3] - T_FLANGE_CAMERA[:3, 3]))


def dataset(recording: Recording, seed: int) -> Dataset:
    """Return a recording, whose transforms are the truth but for the poses' errors."""
    rng = np.random.default_rng(seed)
    camera, pattern, count = LARGE.camera(True), replace(PATTERN, fixed=True).pattern(), recording.poses
    T_camera_board = np.stack([_view(rng, recording) for _ in range(count)])
    pixels = camera.project(apply(T_camera_board, np.broadcast_to(pattern.corners, (count, *pattern.corners.shape))))
    pixels += rng.normal(0.0, CORNER_NOISE, pixels.shape)
    T_world_flange = T_WORLD_BOARD @ inverse(T_camera_board) @ inverse(T_FLANGE_CAMERA)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    T_world_flange[:, :3, 3] += rng.normal(0.0, ARM_NOISE_M, (count, 3))
    T_world_flange[:, :3, :3] = T_world_flange[:, :3, :3] @ exp(rng.normal(0.0, ARM_NOISE_RAD, (count, 3)))
    T_world_flange[:, :3, 3] += SPEED * recording.stamp_error * rng.uniform(-1, 1, (count, 1)) * direction
    ids = [np.flatnonzero(camera.contains(each)) for each in pixels]
    return Dataset(
        path=Path("arm/dataset.json"),
        version="3.0",
        world="world",
        sensors={"camera": Sensor("camera", RGB, "camera_link", *MOUNT, camera)},
        patterns={pattern.name: pattern},
        anchored=None,
        additional_transforms=(),
        collections=tuple(
            Collection(f"{i:03}", {(pattern.name, "camera"): CornerLabels(seen, pixels[i][seen])})
            for i, seen in enumerate(ids)
        ),
        transforms={
            ("world", "flange"): T_world_flange,
            MOUNT: np.repeat(T_FLANGE_CAMERA[None], count, 0),
            ("world", pattern.link): np.repeat(T_WORLD_BOARD[None], count, 0),
        },
        document={},
    )


def _view(rng: np.random.Generator, recording: Recording) -> Array:
    """``T_camera_board`` (4, 4): somewhere in the image, tilted and turned."""
    corners, camera = PATTERN.pattern().corners, LARGE.camera()
    z = camera.fx * float(np.ptp(corners[:, 0])) / (recording.share * camera.width) * rng.uniform(0.9, 1.1)
    azimuth, roll = rng.uniform(-np.pi, np.pi), np.radians(recording.roll) * rng.uniform(-1, 1)
    tilt = np.radians(recording.tilt) * np.sqrt(rng.uniform(0, 1))
    R = exp(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])) @ exp(np.array([0, 0, roll]))
    room = (1 - recording.share) / 2 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    centre = z * np.append(rng.uniform(-1, 1, 2) * room, 1.0)
    return transform(R, centre - R @ PATTERN.pattern().centre)
