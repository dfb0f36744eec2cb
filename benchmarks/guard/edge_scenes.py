"""A camera and a LiDAR on a rig in a textured room: images and scans of the same moments."""

from dataclasses import dataclass

import numpy as np

from benchmarks.guard.clips import Room, drawn_texture
from benchmarks.guard.moving_clips import CAMERA, taken
from benchmarks.guard.room import Rectangle, draw, fan_of_rays, ranges_to
from calibration.addons.guard.witness.depth_edges import CameraAndLidar
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, retract

T_LIDAR_CAMERA = from_xyz_rpy(np.array([0.05, 0.08, -0.12]), np.array([-np.pi / 2, 0.0, -np.pi / 2]))
NOT_MOVED = np.zeros(6)
LENS = np.array([5e-4, 5e-4, 5e-4])


@dataclass(frozen=True)
class RigInRoom:
    """Simulated rig of a camera and a LiDAR in a room; if it is `still`, only people move."""

    seed: int = 1
    moments: int = 12
    still: bool = False
    rings: int = 64
    azimuths: int = 450
    noise_m: float = 0.01
    people: int = 2
    bare: bool = False
    """Whether the room has walls alone, without things before them."""

    def seen(self, shift: Array = NOT_MOVED, begin: int = 0) -> CameraAndLidar:
        """Return what is recorded where the camera is displaced from a moment on, by a twist (6,) in its frame."""
        random = np.random.default_rng(self.seed)
        room = [each for each in Room.drawn(random).rectangles if not self.bare or abs(each.sides).max() > 1]
        walkers = [
            Rectangle(
                np.array([*random.uniform([-1, 0.0], [1, 0.2]), random.uniform(1.5, 3)]),
                np.array([[0.45, 0, 0], [0, 1.5, 0]]), drawn_texture(random, 200), (random.uniform(0.2, 0.6), 0),
            )
            for _ in range(self.people)
        ]  # fmt: skip
        rays = fan_of_rays(self.rings, self.azimuths, (-0.35, 0.35), (-0.8, 0.8))
        images, scans = [], []
        times = np.arange(self.moments, dtype=float)
        for time in times.tolist():
            twist = random.normal(size=6) * [0.3, 0.1, 0.3, 0.05, 0.2, 0.05]
            T = retract(np.eye(4), 0 * twist if self.still else twist)
            things = [*room, *walkers]
            far = ranges_to(things, T @ inverse(T_LIDAR_CAMERA), rays, time)
            scans.append(rays * (far + random.normal(size=len(far)) * self.noise_m)[:, None])
            seen_from = retract(T, shift) if time >= begin else T
            things.sort(key=lambda each: -float(np.linalg.norm(each.corner + each.sides.sum(0) / 2 - T[:3, 3])))
            canvas = np.full((CAMERA.height, CAMERA.width), 90, np.uint8)
            draw(canvas, things, seen_from, CAMERA.K, time)
            images.append(taken(canvas, random))
        return CameraAndLidar(
            "camera", "lidar", images, scans, CAMERA, LENS, inverse(T_LIDAR_CAMERA), 1e-8 * np.eye(6), times
        )
