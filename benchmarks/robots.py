"""Robots with joints, several patterns and a base that moves: what they cost, and whether their error bars are honest.

The systems are those of the tests: a few lines each.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.timing import interleaved
from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.minimisation import minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointParameter
from calibration.engine.geometry.transforms import distance
from tests.engine.estimation.scenes import true_values
from tests.engine.estimation.systems import arm_with_patterns, jointed_arm, mobile_base, stereo, two_patterns

Free = dict[str, tuple[JointParameter, ...]]
JOINT: Free = {"j3": ("origin_yaw",)}
ENCODERS: Free = dict.fromkeys(("j2", "j3", "slide", "j4", "j5"), ("position_bias",))
WEIGHTS = Weighting({"pixel": 0.3}, 2.5)
NOISES = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5))


def measure(quick: bool) -> Iterator[Row]:
    """Truth, error bars, cost, and what is refused."""
    yield from _truth()
    yield from _error_bars(30 if quick else 100)
    yield from _cost(20 if quick else 60)
    yield _refusals()


def _truth() -> Iterator[Row]:
    systems = {
        "a joint": jointed_arm(free=JOINT).dataset(),
        "five encoders": jointed_arm(free=ENCODERS).dataset(),
        "a whole origin": jointed_arm(free={"j3": JOINT_PARAMETERS[:6]}).dataset(),
        "four patterns": arm_with_patterns().dataset(),
        "a moving base": mobile_base(border=False).dataset(),
    }
    for name, dataset in systems.items():
        hold = ("board", "cam") if dataset.moving_transforms else ()
        errors = []
        for noise in NOISES:
            result = calibrate(_off(dataset, 0.05), Options(hold=hold), StartingNoise(*noise))
            apart = [distance(dataset.transforms[edge][0], T) for edge, T in result.transforms.items()]
            errors += [float(each) for both in apart for each in both]
            errors += [float(np.abs(_error(result.joints[j].values, dataset, j)).max()) for j in result.joints]
        note = "m or rad, the worst of all transforms and joints, exact labels, every starting noise"
        yield Row(f"robots/truth, {name}", max(errors), "", Bar(high=1e-6), note)


def _error_bars(scenes: int) -> Iterator[Row]:
    for name, free in (("a joint", JOINT), ("five encoders", ENCODERS)):
        scores: dict[str, list[float]] = {}
        for seed in range(scenes):
            dataset = jointed_arm(20, free=free, pixel_noise=0.3).dataset(seed)
            result = calibrate(_off(dataset, 0.02), Options(loss="linear"))
            for joint in result.joints.values():
                e = _error(joint.values, dataset, joint.name)
                scores.setdefault(joint.name, []).append(float(e @ np.linalg.solve(joint.label_covariance, e)) / len(e))
        mean = float(np.mean([each for block in scores.values() for each in block]))
        spread = ", ".join(f"{block} {np.mean(each):.2f}" for block, each in scores.items())
        yield Row(f"robots/NEES, {name}", mean, "", Bar(0.8, 1.2), f"of its expectation, {scenes} scenes: {spread}")


def _cost(rounds: int) -> Iterator[Row]:
    np.ones(2_000_000)  # a block so large, given back, makes the allocator keep what is freed after it for all works
    for collections in (24, 200, 400):
        arms = {
            name: _solve(jointed_arm(collections, free=free, pixel_noise=0.3).dataset(1))
            for name, free in (("none", {}), ("joint", JOINT))
        }
        yield _ratio("a joint on the chain", arms, collections, rounds)
    for collections in (12, 24, 50, 200, 400):
        several = two_patterns(collections, pixel_noise=0.3)
        one = stereo(collections, pixel_noise=0.3, anchored="left")
        boards = {"none": _solve(one.dataset(1)), "pattern": _solve(several.dataset(1))}
        yield _ratio("a pattern more", boards, collections, rounds)


def _solve(dataset: Dataset) -> tuple[Problem, Values]:
    setup = build(dataset)
    return setup.problem, linear_start(setup, true_values(setup)).values


def _ratio(what: str, problems: dict[str, tuple[Problem, Values]], collections: int, rounds: int) -> Row:
    """Ratio of the least squares' time with it and without, from the linear start, each in its own iterations."""
    works = {name: (lambda p=p, v=v: minimise(p, v, WEIGHTS)) for name, (p, v) in problems.items()}
    times = interleaved(works, rounds)
    without, with_it = times.values()
    more = min(with_it) / min(without) - 1  # a few milliseconds: what else the machine does would decide the median
    iterations = " and ".join(str(minimise(p, v, WEIGHTS).iterations) for p, v in problems.values())
    note = f"{1e3 * min(without):.2f} ms without, {iterations} iterations; the fastest of {rounds} rounds"
    return Row(f"robots/{what}, N={collections}", 100 * more, "% more", Bar(high=20), note)


def _refusals() -> Row:
    """Systems that leave two parameters to make up for each other, and are not refused with both names."""
    cases: dict[str, tuple[Free, tuple[str, str]]] = {
        "joint and mount": ({"j6": ("position_bias",)}, ("joint-j6", "j6-cam")),
        "joint and pattern": ({"j1": ("origin_yaw",)}, ("joint-j1", "board")),
        "angle and encoder": ({"j5": JOINT_PARAMETERS[3:]}, ("position_bias", "origin_pitch")),
    }
    silent = []
    for case, (free, names) in cases.items():
        try:
            calibrate(jointed_arm(free=free, pixel_noise=0.3).dataset())
            silent.append(case)
        except UndeterminedError as error:
            silent += [case] if not all(name in str(error) for name in names) else []
    return Row(
        "robots/not named", float(len(silent)), "", Bar(high=0), f"of {len(cases)}: {', '.join(silent) or 'none'}"
    )


def _off(dataset: Dataset, size: float) -> Dataset:
    """The dataset with all free parameters of joints off by so much (m, rad)."""
    joints = dataset.joints.values()
    return dataset.with_joints({j.name: j.values + size * np.isin(JOINT_PARAMETERS, j.parameters) for j in joints})


def _error(found: np.ndarray, dataset: Dataset, joint: str) -> np.ndarray:
    true = dataset.joints[joint]
    error: np.ndarray = found - true.values[np.isin(JOINT_PARAMETERS, true.parameters)]
    return error
