"""A sensor that has moved within a recording; a second recording of a robot on which nothing has moved."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.verdict.case import Colour, colour_of, judged, with_nothing_set
from benchmarks.verdict.kind import ALL
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import Conditions, generator, recording
from calibration.base import InputError
from calibration.engine.baseline.calibration_document import CalibrationDocument, document_of_calibration
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import Accepted, against_baseline
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.geometry.transforms import retract

MOVES = 200
"""Recordings in which a sensor moves."""
ATTAINABLE_MM = {"t2rgb": 4.0, "rlbot": 6.0, "riwbot": 2.5, "softbot": 5.0, "spjbot": 5.0}
"""Limits that a good recording of the system keeps."""
LIMITS_MOVED = 2.0
ROBOTS = 50
"""Number of robots of each system. Each has a recording that is accepted, and one for each change."""
CHANGES: dict[str, Callable[[np.random.Generator], Conditions]] = {
    "light": lambda rng: Conditions(noise_px=rng.uniform(0.05, 0.3), outliers=rng.uniform(0, 0.01), at_random=True),
    "distance": lambda rng: Conditions(distance=rng.uniform(0.7, 1.4), at_random=True),
    "focus": lambda rng: Conditions(noise_px=rng.uniform(0.2, 0.5), at_random=True),
    "number of poses": lambda rng: Conditions(int(rng.integers(8, 31)), at_random=True),
}


def rows(quick: bool) -> Iterator[Row]:
    """Moves that are red and named; second recordings that are red, by the baseline and by themselves."""
    with ProcessPoolExecutor(os.cpu_count() or 1, get_context("fork")) as pool:
        yield from of_moves(list(pool.map(moved, range(10 if quick else MOVES), chunksize=5)))
        robots = [(name, number) for number in range(1 if quick else ROBOTS) for name in ALL]
        yield from of_pairs([pair for found in pool.map(second_recordings, robots) for pair in found])


@dataclass(frozen=True)
class Move:
    """A sensor that has moved from one of the collections on, and what the verdict says."""

    number: int
    system: str
    first: int
    collections: int
    colour: Colour
    named: bool
    """Whether a reason says what has moved."""
    said: tuple[str, ...]


def moved(number: int) -> Move:
    """A draw: a sensor that moves by twice the limit between any two collections."""
    system = ALL[number % len(ALL)]
    rng = generator("move", number)
    limit = ATTAINABLE_MM[system]
    scene = recording(system, number, number, conditions=Conditions(at_random=True))
    sensors = [sensor for sensor in scene.told.sensors.values() if sensor.name != scene.told.anchored]
    sensor, n = sensors[int(rng.integers(len(sensors)))], len(scene.told.collections)
    first, way = int(rng.integers(1, n)), rng.normal(size=3)
    twists = np.zeros((n, 6))
    twists[first:, :3] = LIMITS_MOVED * limit * 1e-3 * way / np.linalg.norm(way)
    world = scene.world.with_transforms({sensor.edge: retract(scene.world.transforms[sensor.edge], twists)})
    scene = scene.seen_as_in(replace(scene, world=world))
    result, _, _ = judged(with_nothing_set(scene, Limits(translation_mm=limit)))
    named = any(word in reason for reason in result.reasons for word in ("moved", "contradict"))
    return Move(number, system, first, n, colour_of(result), named, (*result.reasons, *result.warnings))


def of_moves(found: list[Move]) -> Iterator[Row]:
    """The rows of the moves."""
    name = f"trust/moved by {LIMITS_MOVED:g} limits"
    red = [each for each in found if each.colour == "red"]
    undecided = sum(each.colour == "undecided" for each in found)
    green = [f"{each.system} at {each.first} of {each.collections}" for each in found if each.colour == "green"]
    note = f"{len(found)} draws, {undecided} undecided; green: {', '.join(green[:6]) or 'none'}"
    yield Row(f"{name}, red", 100 * len(red) / len(found), "%", Bar(low=99), note)
    named = 100 * sum(each.named for each in red) / max(1, len(red))
    yield Row(f"{name}, named", named, "% of red", note="that something has moved, or which views contradict")


@dataclass(frozen=True)
class Pair:
    """A second recording of a robot, and what the verdict says of it."""

    change: str
    system: str
    robot: int
    by_baseline: tuple[str, ...]
    """Red findings of the comparison with the accepted recording."""
    warned: bool
    colour: Colour
    """By itself, with nothing set."""
    reasons: tuple[str, ...]


def second_recordings(which: tuple[str, int]) -> list[Pair]:
    """A robot's recordings with each change, against one that is accepted."""
    system, robot = which
    accepted = Accepted(BaselineSettings(), _accepted(system, robot))
    found = []
    for number, (change, conditions) in enumerate(CHANGES.items(), 1):
        try:
            scene = recording(
                system, robot, number, conditions=conditions(generator(change, system, robot)), links=True
            )
        except InputError:  # too few poses
            continue
        now, colour, reasons = _snapshot(scene)
        if now is None:
            continue
        _, findings = against_baseline(accepted, now)
        red = tuple(each.text for each in findings if each.severity == "red")
        warned = any(each.severity == "warning" for each in findings)
        found.append(Pair(change, system, robot, red, warned, colour, reasons))
    return found


@cache
def _accepted(system: str, robot: int) -> CalibrationDocument:
    now, _, _ = _snapshot(recording(system, robot, 0, conditions=Conditions(at_random=True), links=True))
    assert now
    return now


def _snapshot(scene: Scene) -> tuple[CalibrationDocument | None, Colour, tuple[str, ...]]:
    result, _, calibration = judged(with_nothing_set(scene))
    now = (
        document_of_calibration(calibration, scene.told, calibration.rms_px)
        if calibration and result.converged
        else None
    )
    return now, colour_of(result), result.reasons


def of_pairs(found: list[Pair]) -> Iterator[Row]:
    """The rows of the second recordings."""
    red = [each for each in found if each.by_baseline]
    warned = sum(each.warned for each in found)
    said = f"; {red[0].system} {red[0].robot}, {red[0].change}: {red[0].by_baseline[0][:100]}" if red else ""
    note = f"{len(found)} pairs with other light, distance, focus, number; {warned} warned{said}"
    yield Row("trust/second recording, red", float(len(red)), "by baseline", Bar(high=0), note)
    alone = [each for each in found if each.colour == "red"]
    said = f"; {alone[0].system} {alone[0].robot}, {alone[0].change}: {alone[0].reasons[0][:100]}" if alone else ""
    undecided = sum(each.colour == "undecided" for each in found)
    yield Row("trust/second recording, red alone", float(len(alone)), "", note=f"{undecided} undecided{said}")
