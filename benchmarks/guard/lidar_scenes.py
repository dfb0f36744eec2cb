"""Scans of a LiDAR in a room with boxes, by rays: carried by an arm or a base, whose poses err."""

from dataclasses import dataclass, replace
from itertools import accumulate, chain

import numpy as np

from benchmarks.guard.moving_clips import HandMotion
from benchmarks.guard.room import Rectangle, box, fan_of_rays, ranges_to
from calibration.addons.guard.witness.plane_map import MovingLidar
from calibration.addons.guard.witness.recorded_frames import Carriage
from calibration.base.arrays import Array
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, retract, transform, translation
from calibration.robot.importing.bags.bag import NS_PER_S

T_LINK_LIDAR = from_xyz_rpy(np.array([0.12, 0.03, 0.25]), np.array([0.02, 0.05, 0.4]))
NOT_MOVED = np.zeros(6)
PERSON = np.array([0.4, 0.3, 1.8])
"""m: sides of who walks about."""


@dataclass(frozen=True, eq=False)
class ScannedRoom:
    """A room of 8 x 6 x 3 m with boxes, and a LiDAR in it that stops to scan."""

    seed: int = 1
    scans: int = 24
    rings: int = 24
    azimuths: int = 300
    noise_m: float = 0.01
    offset_m: float = 0.0
    """Error that all ranges of the simulated LiDAR share, m."""
    pose_noise: tuple[float, float] = (1e-3, 1e-3)
    """m and rad."""
    drift: tuple[float, float] = (0.0, 0.0)
    """m and rad: from scan to scan, which adds up as odometry's does."""
    slip: tuple[float, float] = (0.0, 0.0)
    """m and rad: by which the wheels of a base slip, once."""
    planar: bool = False
    """Whether a base carries it, which moves in a plane and turns about z."""
    people: int = 2
    boxes: int = 8
    metres: float = 0.8
    radians: float = 0.5

    def known_poses(self, random: np.random.Generator) -> Array:
        """Return ``T_root_link`` (K, 4, 4)."""
        if not self.planar:
            motion = HandMotion.drawn(random, self.metres, self.radians)
            middle = from_xyz_rpy(np.array([0.0, 0.0, 1.3]), np.array([0.0, 0.0, random.uniform(0, 6)]))
            twists = [motion.amplitudes * np.sin(motion.frequencies * t + motion.phases) for t in self._times]
            return retract(middle, np.stack([each.sum(1) for each in twists]))
        t = self._times / self._times[-1]
        turned = exp(np.stack([0 * t, 0 * t, 3 * np.sin(5 * t + random.uniform(0, 6))], -1) * self.radians)
        places = np.stack([2 * np.sin(4 * t + random.uniform(0, 6)), 1.5 * np.cos(6 * t), 0 * t], -1) * self.metres
        return transform(turned, places)

    @property
    def _times(self) -> Array:
        return np.arange(self.scans, dtype=float)

    def seen(self, shift: Array = NOT_MOVED, begin: int = 0, accepted: float = 1e-4) -> MovingLidar:
        """Return what is recorded where the mount is displaced from a scan on, by a twist (6,) in its frame."""
        random = np.random.default_rng(self.seed)
        known = self.known_poses(random)
        boxes = [self._box(random) for _ in range(self.boxes)]
        steps = retract(
            inverse(known[:-1]) @ known[1:], random.normal(size=(len(known) - 1, 6)) * np.repeat(self.drift, 3)
        )
        slipped = random.normal(size=2) @ np.eye(6)[:2] * self.slip[0] + random.normal() * np.eye(6)[5] * self.slip[1]
        at = int(random.integers(len(steps)))
        steps[at] = retract(steps[at], slipped)
        driven = np.stack(list(accumulate(steps, np.matmul, initial=known[0])))
        noise = random.normal(size=(self.scans, 6)) * np.repeat(self.pose_noise, 3)
        true = retract(driven, noise) @ T_LINK_LIDAR
        true[begin:] = retract(true[begin:], np.tile(shift, (self.scans - begin, 1)))
        people = [(random.uniform(-3, 3, 2), random.uniform(-0.2, 0.2, 2)) for _ in range(self.people)]
        walls = [*box(np.eye(4), np.array([8.0, 6.0, 3.0])), Rectangle(np.zeros(3), np.diag([8.0, 6.0, 0.0])[:2])]
        walls = [replace(each, corner=each.corner - [4, 3, 0]) for each in walls]
        rays, scans = fan_of_rays(self.rings, self.azimuths, (-0.5, 0.5), (0, 2 * np.pi)), []
        for time, T in zip(self._times.tolist(), true, strict=True):
            walking = [box(translation([*(at + speed * time), 0.0]), PERSON) for at, speed in people]
            far = ranges_to([*walls, *chain(*boxes, *walking)], T, rays)
            scans.append(rays * (far + self.offset_m + random.normal(size=len(far)) * self.noise_m)[:, None])
        velocities = np.zeros((self.scans, 6))
        stamps = np.asarray(NS_PER_S * self._times, np.int64)
        return MovingLidar(
            "lidar", Carriage(stamps, T_LINK_LIDAR, accepted**2 * np.eye(6), known, velocities, self.planar), scans
        )

    def _box(self, random: np.random.Generator) -> list[Rectangle]:
        """Return a box near a wall."""
        half = random.uniform([0.3, 0.2, 0.3], [0.8, 0.6, 1.0])
        angle = random.uniform(0, 2 * np.pi)
        at = np.array([3.6 * np.cos(angle), 2.6 * np.sin(angle), half[2]])
        middle = from_xyz_rpy(at, np.array([0.0, 0.0, random.uniform(0, 3)]))
        return box(middle @ translation(-half), 2 * half)
