"""Systems of every modality, with gaps, and cameras that only an arm or a LiDAR links: truth and error bars.

The systems are those of the tests.
"""

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.rows import Bar, Row
from calibration.base import UndeterminedError
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import local
from tests.engine.estimation.scenes import Scene, errors
from tests.engine.estimation.systems import (
    camera_and_lidar2d,
    linked_by_a_lidar,
    linked_by_an_arm,
    tripod,
    tripod_with_gaps,
)

SYSTEMS: dict[str, Callable[..., Scene]] = {
    "camera and 2D LiDAR": camera_and_lidar2d,
    "camera, depth, LiDAR, 2D LiDAR": tripod,
    "each sees a random half": lambda *a, **k: tripod_with_gaps(80, *a, **k),
    "cameras linked by an arm": linked_by_an_arm,
    "cameras linked by a LiDAR": linked_by_a_lidar,
    "cameras linked by a 2D LiDAR": lambda *a, **k: linked_by_a_lidar(*a, flat=True, **k),
}
NOISES = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5), (3.0, 1.5), (3.0, 3.0))
FEWEST = 6


def measure(quick: bool) -> Iterator[Row]:
    """Truth with exact labels, error bars with noisy ones, and how few cuts start a 2D LiDAR."""
    scenes = 30 if quick else 100
    for name, system in SYSTEMS.items():
        dataset = system(border=False).dataset()
        results = [calibrate(dataset, Options(), StartingNoise(*noise)) for noise in NOISES]
        worst = max(max(errors(dataset, result.transforms, result.gauge)) for result in results)
        note = "m or rad, the worst transform, exact labels, every starting noise to 3 m and 3 rad"
        yield Row(f"mixtures/truth, {name}", worst, "", Bar(high=1e-6), note)
    for name, system in SYSTEMS.items():
        yield from _error_bars(name, system, scenes)
    yield _few_cuts(scenes)


def _error_bars(name: str, system: Callable[..., Scene], scenes: int) -> Iterator[Row]:
    scores: dict[tuple[str, str], list[float]] = {}
    guessed = 0
    for seed in range(scenes):
        dataset = system(seed=seed, pixel_noise=0.3, range_noise=0.008).dataset(seed)
        result = calibrate(dataset, Options(loss="linear"), StartingNoise(3.0, 1.5, seed))
        guessed += any("no equation" in warning for warning in result.warnings)
        for edge, covariance in result.label_covariances.items():
            e = local(result.transforms[edge], dataset.transforms[edge][0])
            scores.setdefault(edge, []).append(float(e @ np.linalg.solve(covariance, e)) / 6)
    for edge, each in scores.items():
        note = f"of its expectation, {scenes} scenes from 3 m and 1.5 rad, {guessed} without a linear start"
        yield Row(f"mixtures/NEES, {name}, {edge[1]}", float(np.mean(each)), "", Bar(0.8, 1.2), note)


def _few_cuts(scenes: int) -> Row:
    """Share of scenes with few collections whose optimum from an uninformed start differs from that from the truth."""
    failed, refused = 0, 0
    for seed in range(scenes):
        dataset = camera_and_lidar2d(FEWEST, seed, pixel_noise=0.3, range_noise=0.008).dataset(seed)
        try:
            near = calibrate(dataset, Options(start="given"))
            far = calibrate(dataset, Options(), StartingNoise(3.0, 1.5, seed))
        except UndeterminedError:
            refused += 1
            continue
        if not near.converged:
            refused += 1
            continue
        edge = ("world", "scan")
        apart = local(near.transforms[edge], far.transforms[edge])
        failed += not far.converged or bool(apart @ np.linalg.solve(near.label_covariances[edge], apart) > 0.1)
    note = f"of {scenes} scenes with {FEWEST} collections; {refused} too poor even from the truth"
    return Row("mixtures/2D LiDAR, another optimum", float(failed), "", Bar(high=0.02 * scenes), note)
