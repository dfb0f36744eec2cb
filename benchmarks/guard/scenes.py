"""Scene points as a moving camera finds them: with noise, wrong matches, points that move and points on the hand."""

from dataclasses import dataclass

import numpy as np

from benchmarks.guard.moving_clips import HandMotion
from calibration.addons.guard.witness.bundle import Observations
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import retract

FOCAL_PX = 600.0
HALF_WIDTH = np.array([320, 240]) / FOCAL_PX


@dataclass(frozen=True)
class Scene:
    """What a camera in a hand sees over a table."""

    seed: int = 1
    moments: int = 24
    points: int = 450
    noise_px: float = 0.4
    arm: tuple[float, float] = (2e-4, 3e-4)
    """m and rad: noise of the poses."""
    wrong: float = 0.05
    """Share of wrong matches."""
    moving: float = 0.12
    on_hand: float = 0.05
    """Share of points on the hand, which stay where they are in the image."""
    lag: float = 0.0
    metres: float = 0.15
    radians: float = 0.4

    def seen(self, shift: Array, begin: int = 0) -> tuple[Observations, Array]:
        """Return the observations, and the velocities (K, 6), of a mount that is displaced from a moment on."""
        random = np.random.default_rng(self.seed)
        motion = HandMotion.drawn(random, self.metres, self.radians)
        times = np.linspace(0, 0.75 * self.moments, self.moments)
        known = np.stack([motion.camera(t) for t in times.tolist()])
        velocities = np.stack([motion.velocity(t) for t in times.tolist()])
        true = retract(known, random.normal(size=(len(known), 6)) * np.repeat(self.arm, 3) + self.lag * velocities)
        true[begin:] = retract(true[begin:], np.tile(shift, (self.moments - begin, 1)))
        J = self.points
        points = np.c_[random.uniform(-0.6, 0.6, (J, 2)), random.uniform(-0.05, 0.15, J)]
        kind = random.choice(3, J, p=[1 - self.moving - self.on_hand, self.moving, self.on_hand])
        found = []
        for k, time in enumerate(times.tolist()):
            moved = points + (kind == 1)[:, None] * np.sin(0.3 * time + np.arange(J) % 3)[:, None] * [0.3, 0.1, 0]
            in_camera = (moved - true[k, :3, 3]) @ true[k, :3, :3]
            hand = np.c_[np.arange(J) % 7 - 3, np.arange(J) % 5, np.full(J, 6)] * 0.025
            in_camera = np.where((kind == 2)[:, None], hand, in_camera)
            at = in_camera[:, :2] / in_camera[:, 2:]
            seen = np.flatnonzero((abs(at) < HALF_WIDTH).all(1) & (in_camera[:, 2] > 0.05) & (random.random(J) < 0.6))
            noisy = at[seen] + random.normal(0, self.noise_px / FOCAL_PX, (len(seen), 2))
            is_wrong = random.random(len(seen)) < self.wrong
            noisy[is_wrong] = random.uniform(-HALF_WIDTH, HALF_WIDTH, (is_wrong.sum(), 2))
            found.append(np.c_[np.full(len(seen), k), seen, noisy])
        rows = np.concatenate(found)
        whole = Observations(
            known,
            np.arange(self.moments),
            rows[:, 0].astype(int),
            rows[:, 1].astype(int),
            rows[:, 2:],
            np.arange(J),
            FOCAL_PX,
            3,
        )
        return whole.kept(np.ones(len(rows), bool)), velocities
