"""ATOM's family of systems and those that ship: the truth from exact labels, honest error bars from noisy ones.

Every scene has a motion of its own and the labels that are expected of it, with Gaussian noise in corners and
ranges; nothing is rendered. A moving pattern's pose in each collection has no row: the calibration states no
error bar for it.
"""

import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.workers import on_all_cores
from calibration.dataset.model import Dataset
from calibration.dataset.truth import truth_of
from calibration.estimation.calibrate import Options, calibrate
from calibration.estimation.result import Calibration
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.truth import truth_error
from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.geometry.transforms import local, translation
from calibration.geometry.types import Array
from calibration.simulation.system import System, read_system
from tests.simulation.conftest import DATASETS, SYSTEMS
from tests.simulation.exact_labels import as_designed, exact_labels, noisy
from tests.simulation.family.robots import FAMILY

ROBOTS = {robot.name: robot for robot in FAMILY}
NAMES = (*ROBOTS, *SYSTEMS)
NOISES = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5), (3.0, 1.5), (3.0, 3.0))
Scores = dict[str, tuple[float, int]]
"""By block: ``e^T C^-1 e`` and the number of its parameters."""


def measure(quick: bool) -> Iterator[Row]:
    """For every system the truth, then the error bars of each of its blocks."""
    scenes = 30 if quick else 100
    for number, name in enumerate(NAMES, 1):
        print(f"family: {name}, system {number} of {len(NAMES)}, {scenes} scenes", file=sys.stderr, flush=True)
        yield _truth(name)
        yield from _error_bars(name, on_all_cores(_scores, [(name, seed) for seed in range(scenes)]))


@cache
def _system(name: str) -> System:
    if name in SYSTEMS:
        return read_system(DATASETS / name)
    with tempfile.TemporaryDirectory() as folder:
        return ROBOTS[name].system(Path(folder))


def _truth(name: str) -> Row:
    system = _system(name)
    exact = exact_labels(system)
    truth, start = truth_of(exact), as_designed(exact, system)
    errors = []
    for noise in NOISES:
        found = calibrate(start, None, StartingNoise(*noise))
        error = truth_error(found.dataset, truth)
        errors += [error.translation_mm / 1e3, np.radians(error.rotation_deg), *(each.error for each in error.joints)]
        errors += [] if found.converged else [np.inf]
    note = "m or rad, the worst sensor or joint, exact labels, every starting noise to 3 m and 3 rad"
    return Row(f"family/truth, {name}", float(max(errors)), "", Bar(high=1e-6), note)


def _scores(of: tuple[str, int]) -> Scores:
    """Those of one scene, calibrated by plain least squares from the robot as it was designed."""
    name, seed = of
    system = _system(name)
    exact = exact_labels(system, seed)
    found = calibrate(as_designed(noisy(exact, system, seed), system), Options(loss="linear"))
    assert found.converged, f"{name}, scene {seed}: {found.reason}"
    return dict(_blocks(exact, found))


def _blocks(exact: Dataset, found: Calibration) -> Iterator[tuple[str, tuple[float, int]]]:
    centres = {(p.parent_link, p.link): translation(p.centre) for p in exact.patterns.values()}
    for edge, covariance in found.covariances.items():
        centre = centres.get(edge, np.eye(4))  # a pattern's covariance is that about its centre
        yield edge[1], _score(local(found.transforms[edge] @ centre, exact.transforms[edge][0] @ centre), covariance)
    for joint in found.joints.values():
        at = [JOINT_PARAMETERS.index(parameter) for parameter in joint.parameters]
        yield joint.name, _score(joint.values - exact.joints[joint.name].values[at], joint.covariance)


def _score(error: Array, covariance: Array) -> tuple[float, int]:
    return float(error @ np.linalg.solve(covariance, error)), len(error)


def _error_bars(name: str, scenes: list[Scores]) -> Iterator[Row]:
    """The mean of every block in units of its expectation, against 0.8 to 1.2 or what chance does to so few."""
    for block in dict.fromkeys(block for scene in scenes for block in scene):
        found = [scene[block] for scene in scenes if block in scene]  # some motions never show a pattern
        squares, sizes = zip(*found, strict=True)
        chance = 3 * float(np.sqrt(2 / sum(sizes)))
        bar = Bar.around(1.0, max(0.2, chance))
        note = f"of its expectation, {len(found)} scenes; three standard deviations of such a mean: {chance:.2f}"
        yield Row(f"family/NEES, {name}, {block}", sum(squares) / sum(sizes), "", bar, note)
