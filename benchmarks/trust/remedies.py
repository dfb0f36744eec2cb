"""Whether the remedy that an undecided verdict states makes it decided.

A good robot with a clear limit is recorded as `benchmarks.trust.good_robots` does; where that is undecided, it is
recorded again as the verdict says: with so many collections, or with that known better which it names. A camera_info
that has to be known better is the true one then, stated as exact.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.trust.good_robots import STRATA
from benchmarks.verdict.case import Colour, colour_of, judged, with_nothing_set
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import Conditions, generator, recording
from benchmarks.workers import on_all_cores
from calibration.base import InputError
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO
from calibration.engine.estimation.options import OF_INTRINSICS, Assumptions

DRAWS = 60
LIMITS_MM = (2.0, 5.0)
COLLECTIONS = re.compile(r"take about (\d+) collections")
KNOWN = re.compile(r"has to be known ([\d.]+) times")
MOST_COLLECTIONS = 120
"""More are not recorded: such an advice counts as none that decides."""


@dataclass(frozen=True)
class Remedied:
    """An undecided verdict, and the one after its remedy."""

    system: str
    said: str
    colour: Colour
    why: str


def rows(quick: bool) -> Iterator[Row]:
    """The share of undecided verdicts that are decided after the remedy that they state."""
    for limit in LIMITS_MM:
        found = on_all_cores(remedied, [(number, limit) for number in range(10 if quick else DRAWS)])
        undecided = [each for each in found if each]
        name = f"trust/undecided at {limit:g} mm, decided by the stated remedy"
        if not undecided:
            yield Row(name, skipped="none is undecided")
            continue
        still = [each for each in undecided if each.colour == "undecided"]
        note = f"{len(undecided)} of {len(found)} undecided"
        note += f"; still {still[0].system}: {still[0].why[:160]}" if still else ""
        yield Row(name, 100 - 100 * len(still) / len(undecided), "%", Bar(low=90), note)


def remedied(of: tuple[int, float]) -> Remedied | None:
    """One draw; None where it is decided from the first."""
    number, limit = of
    stratum = STRATA[0]
    system, rng = stratum.systems[number % len(stratum.systems)], generator("remedy", number)
    conditions = Conditions(int(rng.choice(stratum.collections)), float(rng.choice(stratum.distances)), at_random=True)
    limits = Limits(translation_mm=limit)
    scene = with_nothing_set(recording(system, number, number, conditions=conditions), limits)
    result, _, _ = judged(scene)
    if colour_of(result) != "undecided":
        return None
    said = " | ".join(result.undecided)
    more = COLLECTIONS.search(said)
    if more:
        conditions = replace(conditions, collections=int(more[1]))
    if not more and not KNOWN.search(said):
        return Remedied(system, said, "undecided", said)
    if conditions.collections > MOST_COLLECTIONS:
        return Remedied(system, said, "undecided", said)
    try:
        again = with_nothing_set(recording(system, number, number, conditions=conditions), limits)
    except InputError as error:
        return Remedied(system, said, "undecided", str(error))
    result, _, _ = judged(_known_better(again, said))
    return Remedied(system, said, colour_of(result), " | ".join((*result.reasons, *result.undecided)))


def _known_better(scene: Scene, said: str) -> Scene:
    """The scene with what a remedy names known so many times as well."""
    known = KNOWN.search(said)
    if not known:
        return scene
    times = np.ceil(float(known[1]))
    usual = Assumptions()
    scaled = {
        name: value / times
        for name in usual.__dataclass_fields__
        if name not in OF_INTRINSICS and (value := getattr(usual, name)) is not None
    }
    if CAMERA_INFO in said:
        scaled |= dict.fromkeys(OF_INTRINSICS, 0.0)
        cameras = {name: camera for name in scene.cameras if (camera := scene.world.sensors[name].camera)}
        scene = replace(scene, told=scene.told.with_cameras(cameras))
    options = replace(scene.system.options, assume=Assumptions(**scaled))
    return replace(scene, system=replace(scene.system, options=options))
