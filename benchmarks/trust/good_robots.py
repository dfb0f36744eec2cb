"""Good robots as a user records them: how often the verdict with nothing set is red, and that with clear limits."""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from benchmarks.rows import Bar, Row
from benchmarks.verdict.case import Colour, colour_of, judged, with_nothing_set
from benchmarks.verdict.kind import ALL, ARMS
from benchmarks.verdict.strata import Conditions, generator, recording
from calibration.base import InputError
from calibration.engine.diagnosis.limits import Limits

DRAWS = 600
"""Recordings of a stratum."""
LIMITS_MM = (1.0, 2.0, 5.0)
DRAWS_WITH_LIMITS = 100
"""Recordings that are judged with each of the limits."""


@dataclass(frozen=True)
class _Stratum:
    name: str
    systems: tuple[str, ...]
    collections: tuple[int, ...]
    distances: tuple[float, ...]
    bar: Bar


STRATA = (
    _Stratum("8 and more collections", ALL, (8, 12, 20), (0.8, 1.0, 1.5), Bar(high=0.3)),
    _Stratum("arm near the camera", ARMS, (10, 14, 20), (0.6,), Bar(high=1)),
    _Stratum("5 collections", ALL, (5,), (0.8, 1.0, 1.5), Bar(high=3)),
)


@dataclass(frozen=True)
class Draw:
    """A good robot's recording, and the limit that its user has set."""

    stratum: int
    number: int
    limit_mm: float | None = None


@dataclass(frozen=True)
class Judged:
    """Verdict on a recording, the reasons and the warnings."""

    draw: Draw
    system: str
    colour: Colour
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]


def rows(quick: bool) -> Iterator[Row]:
    """Share of red, warned and undecided ones of each stratum; with limits, of red and undecided ones."""
    for k, stratum in enumerate(STRATA):
        found = judge([Draw(k, number) for number in range(10 if quick else DRAWS)])
        name, red = f"trust/clean, {stratum.name}", [each for each in found if each.colour == "red"]
        undecided = [each for each in found if each.colour == "undecided"]
        warned = [each for each in found if each.warnings and each.colour == "green"]
        note = f"{len(found)} recordings, {len(undecided)} undecided{_first(red)}"
        yield Row(f"{name}, red", 100 * len(red) / len(found), "%", stratum.bar, note)
        yield Row(f"{name}, warned", 100 * len(warned) / len(found), "%", stratum.bar)
    for limit in LIMITS_MM:
        found = judge([Draw(0, number, limit) for number in range(10 if quick else DRAWS_WITH_LIMITS)])
        red = [each for each in found if each.colour == "red"]
        undecided = [each for each in found if each.colour == "undecided"]
        note = f"{len(found)} recordings, {len(undecided)} undecided{_first(red)}"
        yield Row(f"trust/clean, limit {limit:g} mm, fail", float(len(red)), "", Bar(high=0), note)


def _first(red: list[Judged]) -> str:
    return f"; {red[0].system} {red[0].draw.number}: {red[0].reasons[0][:100]}" if red and red[0].reasons else ""


def judge(draws: Sequence[Draw]) -> list[Judged]:
    """The verdicts; recordings for which a robot finds too few poses are left out."""
    with ProcessPoolExecutor(os.cpu_count() or 1, get_context("fork")) as pool:
        return [each for each in pool.map(_judged, draws, chunksize=5) if each]


def _judged(draw: Draw) -> Judged | None:
    stratum = STRATA[draw.stratum]
    rng = generator("clean recording", stratum.name, draw.number)
    system = stratum.systems[draw.number % len(stratum.systems)]
    count, distance = int(rng.choice(stratum.collections)), float(rng.choice(stratum.distances))
    conditions = Conditions(count, distance, at_random=True)
    try:
        scene = recording(system, draw.number, draw.number, conditions=conditions, links=True)
    except InputError:
        return None
    result, _, _ = judged(with_nothing_set(scene, Limits(translation_mm=draw.limit_mm)))
    return Judged(draw, system, colour_of(result), result.reasons, result.warnings)
