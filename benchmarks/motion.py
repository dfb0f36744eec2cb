"""Cost of generating a motion, and how well its poses determine a calibration beside other choices."""

from collections.abc import Iterator, Mapping
from itertools import count

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from benchmarks.timing import interleaved
from calibration.base.arrays import IntArray
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.motion_generation import Candidates, find_candidates, generate_motion
from calibration.robot.simulation.motion_information import predicted_sigmas
from calibration.robot.simulation.system import System, read_system

POSES = 26
BARS = {"chance": Bar(high=0.8), "the spread": Bar(high=0.85)}


def measure(quick: bool) -> Iterator[Row]:
    """Motions of 26 poses of the systems that ship."""
    systems = {name: read_system(ROOT / "datasets" / name) for name in ("t2rgb", "rlbot", "riwbot")}
    seeds = count(1)
    works = {
        name: lambda system=system: generate_motion(system, POSES, next(seeds)) for name, system in systems.items()
    }
    for name, seconds in interleaved(works, rounds=3 if quick else 10).items():
        yield Row(f"motion/seconds, {name}", float(np.median(seconds)), "s", Bar(high=1.0), f"{POSES} poses")
    for name, system in systems.items():
        yield from _errors(name, system, 3 if quick else 10)


def _errors(name: str, system: System, seeds: int) -> Iterator[Row]:
    """The predicted error over that of other choices from the same candidates, the median over some seeds."""
    ratios: dict[str, list[float]] = {other: [] for other in BARS}
    stated = []
    for seed in range(seeds):
        motion = generate_motion(system, POSES, seed)
        candidates = find_candidates(system, POSES, seed)
        ours = _error(system, predicted_sigmas(system, motion), motion)
        for other, error in _others(system, candidates, seed).items():
            ratios[other].append(ours / error)
        stated.append(max(predicted_sigmas(system, motion).values()))
    translation, rotation = 1e3 * np.median(stated, axis=0)
    for other, bar in BARS.items():
        note = f"sigma {translation:.3f} mm, {rotation:.3f} mrad; {seeds} seeds, worst {max(ratios[other]):.2f}"
        yield Row(f"motion/error over {other}, {name}", float(np.median(ratios[other])), "times", bar, note)


def _others(system: System, candidates: Candidates, seed: int) -> Mapping[str, float]:
    """The error of the median choice by chance, and of poses that are as different as can be."""
    random = np.random.default_rng(seed)
    by_chance = [random.choice(len(candidates), POSES, replace=False) for _ in range(15)]

    def error(chosen: IntArray | list[int]) -> float:
        motion = candidates.motion.take(np.asarray(chosen, int))
        return _error(system, predicted_sigmas(system, motion), motion)

    return {
        "chance": float(np.median([error(chosen) for chosen in by_chance])),
        "the spread": error(_spread(system, candidates)),
    }


def _error(system: System, sigmas: Mapping[str, tuple[float, float]], motion: Motion) -> float:
    """Translation and rotation together, rad: a translation counts by the angle that it makes at the pattern."""
    T_camera_pattern = place(system, motion).pattern_in(next(iter(system.cameras)), next(iter(system.patterns)))
    distance = float(np.linalg.norm(T_camera_pattern[:, :3, 3], axis=-1).mean())
    return max(float(np.hypot(translation / distance, rotation)) for translation, rotation in sigmas.values())


def _spread(system: System, candidates: Candidates) -> list[int]:
    """Choose poses, each the farthest from all before it by the pattern's place, distance, tilt and turn."""
    T = place(system, candidates.motion).pattern_in(next(iter(system.cameras)), next(iter(system.patterns)))
    features = np.concatenate([T[:, :2, 3] / T[:, 2:3, 3], T[:, 2:3, 3], T[:, :2, 2], T[:, :2, 0]], -1)
    chosen, nearest = [0], np.full(len(features), np.inf)
    while len(chosen) < POSES:
        nearest = np.minimum(nearest, np.linalg.norm(features - features[chosen[-1]], axis=-1))
        chosen.append(int(nearest.argmax()))
    return chosen
