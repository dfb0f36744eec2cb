"""Cameras that move: what is found of planted displacements, and what is said where nothing moved or can be told.

In bulk with scene points (`benchmarks.guard.scenes`), some with images (`benchmarks.guard.moving_clips`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from benchmarks.guard.moving_clips import CAMERA, T_LINK_CAMERA, HandMotion, Table, taken
from benchmarks.guard.scenes import Scene
from benchmarks.rows import Bar, Row
from calibration.addons.guard.features import Features, find_features
from calibration.addons.guard.outcome import MAX_FALSE_ALARM, SensorCheck
from calibration.addons.guard.witness.bundle import evidence_of
from calibration.addons.guard.witness.checks import POSE_NOISE, MovingCamera, check_by_each_other, check_by_motion
from calibration.addons.guard.witness.displacement import Displacement, displacement_of
from calibration.base.arrays import Array
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import adjoint, inverse, retract, transform

LENS = np.full(3, 2e-4)
ACCEPTED = np.diag(np.square([1e-4] * 6))
"""Covariance of the accepted mount: 0.1 mm and 0.1 mrad."""
IMAGE_STEP = 0.5
T_STEREO = transform(exp(np.array([0.0, -0.1, 0.0])), np.array([0.08, 0.0, 0.0]))


def direction(random: np.random.Generator) -> Array:
    """A unit vector."""
    drawn = random.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def found_by_points(seed: int, shift: Array, begin: int) -> Displacement:
    """What is found of a scene of points."""
    observations, velocities = Scene(seed, moments=30, points=500).seen(shift, begin)
    evidence = evidence_of(observations, LENS)
    if evidence is None:
        raise AssertionError("a scene has points")
    return displacement_of(evidence, velocities, POSE_NOISE, LENS, np.zeros((6, 6)))


def unmoved_scenes(seeds: Sequence[int]) -> dict[str, float]:
    """The false alarms, and the mean of T^2 over its expectation, of scenes where nothing has moved."""
    found = [found_by_points(seed, np.zeros(6), 0) for seed in seeds]
    squares = [float(each.twist @ np.linalg.solve(each.covariance, each.twist)) for each in found if not each.begin]
    red = sum(each.p < MAX_FALSE_ALARM for each in found)
    return {
        "scenes": len(found),
        "red": red,
        "T2 / 6": float(np.mean(squares) / 6),
        "T2 at 99 %": float(np.quantile(squares, 0.99)),
        "smallest p": min(each.p for each in found),
    }


def planted_scenes(seeds: Sequence[int], sigmas: tuple[float, float]) -> dict[str, float]:
    """What is found of displacements of so many stated standard deviations, in any direction, from any moment on."""
    red = in_time = 0
    for seed in seeds:
        random = np.random.default_rng(seed)
        begin = int(random.integers(6, 24)) * int(random.integers(2))
        C = found_by_points(seed, np.zeros(6), 0).covariance
        spread = math.sqrt(30 / (30 - begin))  # fewer images see it
        drawn = random.normal(size=6)
        shift = np.asarray(np.linalg.cholesky(C) @ drawn / np.linalg.norm(drawn) * random.uniform(*sigmas) * spread)
        found = found_by_points(seed, shift, begin)
        red += found.p < MAX_FALSE_ALARM
        in_time += abs(found.begin - begin) * 0.75 <= 1.0
    return {"scenes": len(seeds), "red": red / len(seeds), "moment within 1 s": in_time / len(seeds)}


def hand_clip(
    seed: int, shift: Array, since: float, *, images: int = 40, textured: float = 1.0, metres: float = 0.15,
    radians: float = 0.35, moving: int = 2, wandering: float = 0.0,
) -> MovingCamera:  # fmt: skip
    """What a camera in a hand sees over a table; from a moment on its mount is displaced."""
    random = np.random.default_rng(seed)
    motion, table = HandMotion.drawn(random, metres, radians), Table.drawn(random, moving=moving, textured=textured)
    times = np.asarray(IMAGE_STEP * np.arange(images), float)
    features = []
    for time in times.tolist():
        T = retract(motion.camera(time), random.normal(size=6) * np.repeat([1e-4, 2e-4], 3))
        T = retract(T, shift) if time >= since else T
        T = retract(T, wandering * random.normal(size=6))
        features.append(find_features(taken(table.seen(T, time), random)))
    return _camera("hand", times, features, motion)


def stereo_clip(seed: int, shift: Array, since: float, images: int = 12) -> tuple[MovingCamera, MovingCamera]:
    """What two cameras on a body that moves see; from a moment on the second one is displaced."""
    random = np.random.default_rng(seed)
    motion, table = HandMotion.drawn(random), Table.drawn(random)
    times = np.asarray(IMAGE_STEP * np.arange(images), float)
    features: tuple[list[Features], list[Features]] = ([], [])
    for time in times.tolist():
        one = motion.camera(time)
        other = retract(one @ T_STEREO, shift if time >= since else np.zeros(6))
        for own, T in zip(features, (one, other), strict=True):
            own.append(find_features(taken(table.seen(T, time), random)))
    first, second = (_camera(name, times, own, motion) for name, own in zip(("left", "right"), features, strict=True))
    return first, replace(second, T_link_camera=T_LINK_CAMERA @ T_STEREO)


def _camera(name: str, times: Array, features: list[Features], motion: HandMotion) -> MovingCamera:
    links = np.stack([motion.camera(time) for time in times.tolist()]) @ inverse(T_LINK_CAMERA)
    velocities = np.stack([motion.velocity(time) for time in times.tolist()]) @ adjoint(T_LINK_CAMERA).T
    return MovingCamera(name, CAMERA, LENS, T_LINK_CAMERA, ACCEPTED, times, features, links, velocities)


def hand_checks(seeds: Sequence[int], degrees: float, metres: float) -> list[tuple[SensorCheck, float]]:
    """What is said of clips of a camera in a hand, and the moment from which on it was displaced; 0 for all along."""
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed + 10**6)
        since = float(random.choice([0.0, random.uniform(4, 16)]))
        shift = np.concatenate([metres * direction(random), math.radians(degrees) * direction(random)])
        found.append((check_by_motion(hand_clip(seed, shift, since), POSE_NOISE), since))
    return found


def stereo_checks(seeds: Sequence[int], degrees: float) -> list[tuple[SensorCheck, float]]:
    """What is said of the second of two cameras, likewise."""
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed + 10**6)
        since = float(random.choice([0.0, random.uniform(2, 4)]))
        shift = np.concatenate([np.zeros(3), math.radians(degrees) * direction(random)])
        found.append((check_by_each_other(*stereo_clip(seed, shift, since)), since))
    return found


def measure(quick: bool) -> Iterator[Row]:
    """False red and power of points in bulk; the smallest displacements and what cannot be told, of images."""
    cv2.setNumThreads(1)
    unmoved, planted, clips, blind = (60, 30, 10, 8) if quick else (1000, 500, 100, 200)
    null = unmoved_scenes(range(unmoved))
    yield Row("guard/moving/false red", 100 * null["red"] / unmoved, "%", Bar(high=0.1), f"{unmoved} scenes of points")
    yield Row("guard/moving/T2 over 6", null["T2 / 6"], "", Bar(0.7, 1.2), f"at 99 %: {null['T2 at 99 %']:.1f}")
    for least, bar in ((5.0, None), (7.0, Bar(low=99))):
        shifts = planted_scenes(range(planted), (least, 15.0))
        note = f"{planted} scenes of points, moment within 1 s: {100 * shifts['moment within 1 s']:.1f} %"
        yield Row(f"guard/moving/found above {least:g} sigma", 100 * shifts["red"], "%", bar, note)
    for name, degrees, metres in (("0.3 deg", 0.3, 0.0), ("5 mm", 0.0, 0.005)):
        yield _row_of_checks(f"guard/hand/found of {name}", hand_checks(range(clips), degrees, metres))
    yield _row_of_checks("guard/stereo/found of 0.1 deg", stereo_checks(range(clips), 0.1))
    untold = sum(check.outcome == "cannot-tell" for _, check in blind_checks(range(blind)))
    yield Row("guard/moving/cannot tell, and said so", 100 * untold / blind, "%", Bar(low=100), f"{blind} clips")


def _row_of_checks(name: str, found: Sequence[tuple[SensorCheck, float]]) -> Row:
    red = [(check, since) for check, since in found if check.red]
    late = [abs((check.since or 0.0) - since) for check, since in red]
    note = f"{len(found)} clips, moment off by {max(late, default=0.0):.1f} s at most"
    return Row(name, 100 * len(red) / len(found), "%", Bar(low=99), note)


BLIND_CLIPS: Mapping[str, dict[str, Any]] = {
    "no texture": {"textured": 0.0},
    "no motion": {"metres": 0.0, "radians": 0.0},
    "all moves": {"wandering": 0.02},
    "few images": {"images": 5},
}
"""Clips of which nothing can be told."""


def blind_checks(seeds: Sequence[int]) -> list[tuple[str, SensorCheck]]:
    """What is said of clips that cannot tell."""
    kinds = list(BLIND_CLIPS)
    found = []
    for i, seed in enumerate(seeds):
        kind = kinds[i % len(kinds)]
        clip = hand_clip(seed, np.zeros(6), 0.0, **{"images": 16, **BLIND_CLIPS[kind]})
        found.append((kind, check_by_motion(clip, POSE_NOISE)))
    return found
