"""LiDARs that move: what is found of planted displacements, and what is said where nothing has moved."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.guard.lidar_scenes import ScannedRoom
from benchmarks.guard.witnessed import direction
from benchmarks.rows import Bar, Row
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.plane_map import check_by_map

CARRIED: Mapping[str, Mapping[str, Any]] = {
    "arm": {"metres": 0.4, "pose_noise": (2e-4, 3e-4)},
    "base": {"planar": True, "pose_noise": (1e-3, 1e-3), "drift": (2e-3, 5e-4)},
}
"""What carries it: an arm, or a base by its odometry, which drifts by 2 mm and 0.03 degrees from stop to stop."""
SMALLEST = {"arm": (0.3, 0.005), "base": (1.0, 0.03)}
"""Displacements that are planted, degrees and m."""


def room_of(carrier: str, seed: int) -> ScannedRoom:
    """Return a room, every second time with ranges that are 5 mm too long."""
    return replace(ScannedRoom(seed, offset_m=0.005 * (seed % 2)), **CARRIED[carrier])


def unmoved_lidars(carrier: str, seeds: Sequence[int]) -> list[SensorCheck]:
    """Return the checks of LiDARs that did not move, one a seed."""
    return [check_by_map(room_of(carrier, seed).seen()) for seed in seeds]


def displaced_lidars(
    carrier: str, seeds: Sequence[int], degrees: float, metres: float
) -> list[tuple[SensorCheck, int]]:
    """What is said of displacements in any direction (of a base, but upwards), and the scan at which each begins."""
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed + 10**6)
        begin = int(random.integers(6, 18)) * int(random.integers(2))
        shift = direction(random) * [1, 1, float(carrier != "base")]
        shift = np.concatenate([metres * shift / np.linalg.norm(shift), math.radians(degrees) * direction(random)])
        found.append((check_by_map(room_of(carrier, seed).seen(shift, begin)), begin))
    return found


def measure(quick: bool) -> Iterator[Row]:
    """False red, and the power."""
    unmoved, planted = (20, 10) if quick else (1000, 500)
    for carrier, (degrees, metres) in SMALLEST.items():
        checks = unmoved_lidars(carrier, range(unmoved))
        seen = float(np.median([each.unseen_deg or math.inf for each in checks]))
        note = f"{unmoved} rooms; {seen:.2f} degrees would be seen (median)"
        yield Row(
            f"guard/{carrier}'s LiDAR/false red",
            100 * sum(each.red for each in checks) / unmoved,
            "%",
            Bar(high=0.1),
            note,
        )
        for name, size in ((f"{degrees:g} deg", (degrees, 0.0)), (f"{1e3 * metres:g} mm", (0.0, metres))):
            found = displaced_lidars(carrier, range(planted), *size)
            late = [abs((check.since or 0.0) - begin) for check, begin in found if check.red]
            note = f"{planted} rooms; moment within 1 s of {sum(each <= 1 for each in late)}"
            share = 100 * float(np.mean([check.red for check, _ in found]))
            yield Row(f"guard/{carrier}'s LiDAR/found of {name}", share, "%", Bar(low=99), note)
