"""The accepted baseline: false alarms and moves found between two recordings of a robot, and changes in histories."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from itertools import combinations

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.verdict.strata import entries, recording
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import CalibrationDocument, document_of_calibration
from calibration.engine.baseline.comparison import BaselineComparison, compare
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.statistics import change_points, creeps, noise_of

ROBOTS, RECORDINGS = 40, 6
"""Of each system, and of each robot: 15 pairs."""
SIGMAS = 5.0
"""A sensor is moved by so many standard deviations of the difference, in any direction."""
SEEDS = 60
"""Of each shape of history."""


def measure(quick: bool) -> Iterator[Row]:
    """Pairs of recordings of good robots, with and without a move; histories of known shapes."""
    robots = 4 if quick else ROBOTS
    with ProcessPoolExecutor() as pool:
        for name in entries():
            found = list(pool.map(partial(_still, name), range(robots)))
            red, pairs = sum(each[0] for each in found), sum(each[1] for each in found)
            yield Row(f"baseline/{name}, nothing moved", 100 * red / pairs, "% red", Bar(high=0.1), f"of {pairs} pairs")
            moves = [each for robot in pool.map(partial(_moved, name), range(robots)) for each in robot]
            red, named = sum(each[0] for each in moves), sum(each[1] for each in moves)
            note = f"{SIGMAS:g} sigma of the difference in any direction, of {len(moves)}"
            yield Row(f"baseline/{name}, moved", 100 * red / len(moves), "% red", Bar(low=99), note)
            yield Row(
                f"baseline/{name}, named", 100 * named / max(red, 1), "% of red", Bar(low=98), "first by its sensor"
            )
    yield from _histories(quick)


@cache
def _taken(name: str, robot: int, seed: int, sensor: str = "", twist: tuple[float, ...] = ()) -> CalibrationDocument:
    scene = recording(name, robot, seed, {sensor: np.array(twist)} if sensor else {})
    found = calibrate(scene.told, Options())
    return document_of_calibration(found, scene.told, found.rms_px)


def _red(comparison: BaselineComparison) -> list[str]:
    changes = [each for each in comparison.changes if each.p < comparison.significance]
    return [each.name for each in sorted(changes, key=lambda each: -each.sigmas)]


def _still(name: str, robot: int) -> tuple[int, int]:
    """Number of pairs of recordings that are red, and of all pairs."""
    taken = [_taken(name, robot, seed) for seed in range(RECORDINGS)]
    pairs = list(combinations(taken, 2))
    return sum(bool(_red(compare(*pair))) for pair in pairs), len(pairs)


def _moved(name: str, robot: int) -> list[tuple[bool, bool]]:
    """Whether a move of each sensor is red, and named first."""
    before, found = _taken(name, robot, 0), []
    rng = np.random.default_rng([robot, 7])
    for pose in before.poses:
        if pose.sensor is None or pose.covariance is None:
            continue
        change = next(each for each in compare(before, _taken(name, robot, 1)).changes if each.name == pose.name)
        translation, rotation = rng.normal(size=(2, 3))
        translation *= SIGMAS * 1e-3 * change.sigma_mm / np.linalg.norm(translation)
        rotation *= SIGMAS * np.radians(change.sigma_deg) / np.linalg.norm(rotation)
        for twist in ((*translation, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, *rotation)):
            red = _red(compare(before, _taken(name, robot, 1, pose.sensor, tuple(map(float, twist)))))
            found.append((bool(red), red[:1] == [pose.name]))
    return found


Shape = Callable[[np.random.Generator], tuple[Array, list[int], bool]]
"""A series (n, 6) in standard deviations, where its level changes, and whether it creeps."""


def _levels(*parts: tuple[int, float], noise: float = 1.0) -> Shape:
    def make(rng: np.random.Generator) -> tuple[Array, list[int], bool]:
        level = np.concatenate([np.full(count, height) for count, height in parts])
        return _along(level, noise, rng), np.cumsum([count for count, _ in parts])[:-1].tolist(), False

    return make


def _curve(n: int, height: Callable[[Array], Array], creeping: bool) -> Shape:
    return lambda rng: (_along(height(np.arange(n)), 1.0, rng), [], creeping)


def _along(level: Array, noise: float | Array, rng: np.random.Generator) -> Array:
    direction = rng.normal(size=6)
    spread = np.broadcast_to(noise, level.shape)[:, None] * rng.normal(size=(len(level), 6))
    return np.outer(level, direction / np.linalg.norm(direction)) + spread


def _heavy(rng: np.random.Generator) -> tuple[Array, list[int], bool]:
    return rng.standard_t(5, size=(40, 6)) / np.sqrt(5 / 3), [], False


def _wider(rng: np.random.Generator) -> tuple[Array, list[int], bool]:
    return _along(np.zeros(40), np.repeat([0.5, 1.5], 20), rng), [], False


SHAPES: dict[str, Shape] = {
    "still": _levels((40, 0)),
    "still, short": _levels((6, 0)),
    "heavy tails": _heavy,
    "variance": _wider,
    "seasonal": _curve(40, lambda i: 1.0 * np.sin(i / 3), False),
    "step": _levels((20, 0), (20, 10)),
    "small step": _levels((30, 0), (30, 5)),
    "early step": _levels((3, 0), (37, 10)),
    "late step": _levels((37, 0), (3, 10)),
    "last commit": _levels((39, 0), (1, 12)),
    "step and back": _levels((15, 0), (10, 10), (15, 0)),
    "two steps": _levels((15, 0), (15, 8), (15, 20)),
    "spike": _levels((20, 0), (1, 15), (19, 0)),
    "several": _levels((10, 0), (10, 9), (10, -4), (10, 8), (10, 0)),
    "few commits": _levels((4, 0), (4, 15)),
    "drift": _curve(40, lambda i: 0.5 * i, True),
    "slow drift": _curve(60, lambda i: 0.15 * i, True),
}


def _histories(quick: bool) -> Iterator[Row]:
    """F1 of changes within one commit, against apache-otava on the same series, where that is installed."""
    seeds = range(10 if quick else SEEDS)
    begin = time.perf_counter()
    ours = [_ours(shape(np.random.default_rng([seed, 11]))) for shape in SHAPES.values() for seed in seeds]
    taken = time.perf_counter() - begin
    exact, note = sum(each[3] for each in ours), f"{len(SHAPES)} shapes, {len(ours)} series in {taken:.1f} s"
    yield Row("baseline/histories, F1", _f1(ours), "", Bar(low=0.9), note)
    hits = sum(each[0] for each in ours)
    yield Row(
        "baseline/histories, at the commit", 100 * exact / max(hits, 1), "%", note="of the changes found within one"
    )
    drifts = [
        _creeps(SHAPES[name](np.random.default_rng([seed, 11]))[0]) == SHAPES[name](np.random.default_rng(0))[2]
        for name in SHAPES
        for seed in seeds
    ]
    yield Row(
        "baseline/histories, creeping", 100 * float(np.mean(drifts)), "% right", Bar(low=95), "drifts and all others"
    )
    try:
        from otava.analysis import compute_change_points
    except ImportError:
        yield Row("baseline/histories, F1 of otava", skipped="pip install apache-otava")
        return
    theirs = [
        _theirs(shape(np.random.default_rng([seed, 11])), compute_change_points)
        for shape in SHAPES.values()
        for seed in seeds
    ]
    yield Row("baseline/histories, F1 of otava", _f1(theirs), "", note="on the column that changes most")


def _creeps(values: Array) -> bool:
    noise = noise_of(values, np.ones(6))
    return creeps(values, noise, change_points(values, noise))


def _ours(case: tuple[Array, list[int], bool]) -> tuple[int, int, int, int]:
    values, true, _ = case
    noise = noise_of(values, np.ones(6))
    found = change_points(values, noise)
    return _counts([] if creeps(values, noise, found) else found, true)


def _theirs(case: tuple[Array, list[int], bool], compute: Callable[..., object]) -> tuple[int, int, int, int]:
    values, true, _ = case
    column = values[:, int(np.ptp(values, axis=0).argmax())]
    try:
        found = compute(column, window_len=30, max_pvalue=0.001, min_magnitude=0.0)
    except ValueError:  # of a candidate at the series' end: it finds nothing then
        found = []
    points = found[0] if isinstance(found, tuple) else found
    return _counts([point.index for point in points], true)  # type: ignore[attr-defined]


def _counts(found: Sequence[int], true: Sequence[int]) -> tuple[int, int, int, int]:
    """True positives within one commit, false positives, false negatives, and those at the very commit."""
    left, hits, exact = list(true), 0, 0
    for at in found:
        near = [each for each in left if abs(each - at) <= 1]
        if near:
            best = min(near, key=lambda each: abs(each - at))
            left.remove(best)
            hits += 1
            exact += best == at
    return hits, len(found) - hits, len(left), exact


def _f1(counts: Sequence[tuple[int, int, int, int]]) -> float:
    hits, false, missed = (sum(each[k] for each in counts) for k in range(3))
    return 2 * hits / (2 * hits + false + missed)


if __name__ == "__main__":
    for row in measure("--quick" in sys.argv):
        print(row.line(), flush=True)
