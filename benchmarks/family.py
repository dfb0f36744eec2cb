"""ATOM's family of systems and those that ship: the truth from exact labels, honest error bars from noisy ones.

Every scene has a motion of its own and the labels that are expected of it, with Gaussian noise in corners and
ranges; nothing is rendered. A moving pattern's pose in each collection has no row: the calibration states no
error bar for it. A pattern's border as a LiDAR or a depth camera sees it is told by the last ray or pixel on the
pattern, whose errors are no Gaussian noise: systems that have such a sensor are measured without it, and with it.
"""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.workers import on_all_cores
from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import truth_error, truth_of
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import local
from calibration.robot.simulation.system import System, read_system
from tests.robot.simulation.conftest import DATASETS, SYSTEMS
from tests.robot.simulation.exact_labels import as_designed, exact_labels, noisy
from tests.robot.simulation.family.robots import FAMILY

ROBOTS = {robot.name: robot for robot in FAMILY}
NAMES = (*ROBOTS, *SYSTEMS)
NOISES = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5), (3.0, 1.5), (3.0, 3.0))
Scores = dict[str, tuple[float, int]]
"""By block: ``e^T C^-1 e`` and the number of its parameters."""


def measure(quick: bool) -> Iterator[Row]:
    """Measure each system against the truth, and the error bars of each of its blocks."""
    scenes = 30 if quick else 100
    for number, name in enumerate(NAMES, 1):
        print(f"family: {name}, system {number} of {len(NAMES)}, {scenes} scenes", file=sys.stderr, flush=True)
        yield _truth(name)
        found = on_all_cores(_scores, [(name, seed) for seed in range(scenes)])
        yield from _error_bars(name, [plain for plain, _ in found])
        yield from _with_border(name, [border for _, border in found if border])


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


def _scores(of: tuple[str, int]) -> tuple[Scores, Scores]:
    """Scores of a scene without border labels, and with them if it has any."""
    name, seed = of
    system = _system(name)
    exact = exact_labels(system, seed)
    labelled = as_designed(noisy(exact, system, seed), system)
    borderless = _without_border(labelled)
    plain = _calibrated(borderless, exact)
    return plain, _calibrated(labelled, exact) if borderless is not labelled else {}


def _calibrated(labelled: Dataset, exact: Dataset) -> Scores:
    """Calibrate by plain least squares."""
    found = calibrate(labelled, Options(loss="linear"))
    assert found.converged, found.reason
    return dict(_blocks(exact, found))


def _without_border(dataset: Dataset) -> Dataset:
    """The same dataset where nothing labels a border."""
    if all(isinstance(labels, CornerLabels) for c in dataset.collections for labels in c.labels.values()):
        return dataset
    collections = tuple(
        replace(
            c,
            labels={
                key: replace(labels, limits=labels.limits[:0]) if isinstance(labels, PointLabels) else labels
                for key, labels in c.labels.items()
            },
        )
        for c in dataset.collections
    )
    return replace(dataset, collections=collections)


def _blocks(exact: Dataset, found: Calibration) -> Iterator[tuple[str, tuple[float, int]]]:
    for edge, covariance in found.label_covariances.items():
        yield edge[1], _score(local(found.transforms[edge], exact.transforms[edge][0]), covariance)
    for joint in found.joints.values():
        at = [JOINT_PARAMETERS.index(parameter) for parameter in joint.parameters]
        yield joint.name, _score(joint.values - exact.joints[joint.name].values[at], joint.label_covariance)


def _score(error: Array, covariance: Array) -> tuple[float, int]:
    return float(error @ np.linalg.solve(covariance, error)), len(error)


def _error_bars(name: str, scenes: list[Scores]) -> Iterator[Row]:
    """The mean of every block in units of its expectation, against 0.8 to 1.2 or what chance does to so few."""
    for block, (mean, found, chance) in _means(scenes).items():
        note = f"of its expectation, {found} scenes; three standard deviations of such a mean: {chance:.2f}"
        yield Row(f"family/NEES, {name}, {block}", mean, "", Bar.around(1.0, max(0.2, chance)), note)


def _with_border(name: str, scenes: list[Scores]) -> Iterator[Row]:
    """No error bar may be too narrow; steps of a scan average out faster than independent errors, so some are wide."""
    for block, (mean, found, _) in _means(scenes).items():
        note = f"of its expectation, {found} scenes; steps and pixels err less together than noise would"
        yield Row(f"family/NEES with border, {name}, {block}", mean, "", Bar(high=1.2), note)


def _means(scenes: list[Scores]) -> dict[str, tuple[float, int, float]]:
    """Mean by block, with the number of scenes that have it and three standard deviations of such a mean."""
    means = {}
    for block in dict.fromkeys(block for scene in scenes for block in scene):
        found = [scene[block] for scene in scenes if block in scene]  # some motions never show a pattern
        squares, sizes = zip(*found, strict=True)
        means[block] = sum(squares) / sum(sizes), len(found), 3 * float(np.sqrt(2 / sum(sizes)))
    return means
