"""Other ways to choose poses, to compare with."""

import numpy as np

from calibration.base.arrays import Array
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion_generation import Candidates
from calibration.robot.simulation.system import System


def at_random(candidates: Candidates, count: int, seed: int) -> list[int]:
    """Any poses."""
    chosen: list[int] = np.random.default_rng(seed).choice(len(candidates), count, replace=False).tolist()
    return chosen


def spread(system: System, candidates: Candidates, count: int) -> list[int]:
    """Choose poses that differ: the next one is the farthest from all previous ones, by the pattern's pose."""
    T = place(system, candidates.motion).pattern_in(next(iter(system.cameras)), next(iter(system.patterns)))
    features: Array = np.concatenate([T[:, :3, 3] / T[:, 2:3, 3], T[:, 2:3, 3], 2 * T[:, :2, 2], T[:, :2, 0]], -1)
    chosen = [0]
    distance = np.full(len(features), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=-1))
        chosen.append(int(distance.argmax()))
    return chosen
