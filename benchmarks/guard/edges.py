"""A camera and a LiDAR on a rig: what is found of planted turns, and what is said where nothing has moved."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.guard.edge_scenes import RigInRoom
from benchmarks.guard.witnessed import direction
from benchmarks.rows import Bar, Row
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.depth_edges import check_by_edges

MOMENTS = 20
TURNS_DEG = (0.3, 0.5, 1.0)


def unmoved_rigs(seeds: Sequence[int]) -> list[SensorCheck]:
    """Return the checks of rigs whose sensors did not move, one a seed; every second rig stands still."""
    return [check_by_edges(RigInRoom(seed, MOMENTS, still=bool(seed % 2)).seen()) for seed in seeds]


def turned_rigs(seeds: Sequence[int], degrees: float) -> list[tuple[SensorCheck, int]]:
    """Return the checks of rigs whose camera was turned about a random axis, and the moment at which it was."""
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed + 10**6)
        begin = int(random.integers(5, 15)) * int(random.integers(2))
        turn = np.concatenate([np.zeros(3), math.radians(degrees) * direction(random)])
        found.append((check_by_edges(RigInRoom(seed, MOMENTS, still=bool(seed % 2)).seen(turn, begin)), begin))
    return found


def measure(quick: bool) -> Iterator[Row]:
    """False red, the power, and what cannot be told."""
    unmoved, planted, blind = (20, 10, 4) if quick else (1000, 200, 50)
    checks = unmoved_rigs(range(unmoved))
    seen = float(np.median([each.unseen_deg or math.inf for each in checks]))
    note = f"{unmoved} rigs; {seen:.2f} degrees would be seen (median)"
    yield Row(
        "guard/camera and LiDAR/false red", 100 * sum(each.red for each in checks) / unmoved, "%", Bar(high=0.1), note
    )
    for degrees in TURNS_DEG:
        found = turned_rigs(range(planted), degrees)
        late = [abs((check.since or 0.0) - begin) for check, begin in found if check.red]
        note = f"{planted} rigs; moment within 1 s of {sum(each <= 1 for each in late)}"
        share = 100 * float(np.mean([check.red for check, _ in found]))
        yield Row(f"guard/camera and LiDAR/found of {degrees:g} deg", share, "%", None, note)
    bare = [check_by_edges(RigInRoom(seed, bare=True, people=0).seen()) for seed in range(blind)]
    untold = sum(each.outcome == "cannot-tell" for each in bare)
    yield Row("guard/camera and LiDAR/cannot tell, said so", 100 * untold / blind, "%", Bar(low=100), "bare walls")
