"""Next poses: whether what is promised is reached, how many poses a limit takes, and what the advice costs."""

import itertools
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scenes import rig
from benchmarks.shared_data import load, missing
from benchmarks.verdict.recordings import NO_ARM, real_arm
from calibration.base import CalibrationError
from calibration.base.arrays import Array, IntArray
from calibration.base.verdict import FlakeRate
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.diagnosis.limits import Limits, stated
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT, Assumptions, Options
from calibration.engine.geometry.transforms import retract
from calibration.engine.next_pose import Goal, Knowledge, PoseAdvisor, knowledge_of, pose_advisor
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import task_errors
from calibration.robot.next_pose.candidates import candidates_of
from calibration.robot.next_pose.plan import motion_of
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion, joined, moving_model
from calibration.robot.simulation.motion_generation import find_candidates
from calibration.robot.simulation.motion_information import expected_dataset
from calibration.robot.simulation.system import System, read_system

SYSTEMS_FOLDER = Path(__file__).parents[1] / "datasets"
NAMES_OF_SYSTEMS = ("t2rgb", "riwbot", "rlbot", "softbot", "spjbot")
ROBOTS, QUICK_ROBOTS = int(os.environ.get("ROBOTS", "200")), 40
"""In all; as many as the variable ROBOTS says."""
FOLLOWED_POSES = 4
"""Poses that are advised and taken."""
RATIO_LIMITS = (0.8, 1.25)
"""Promised over reached."""
HAND_MM, HAND_DEG = 20.0, 3.0
"""Standard deviations, each axis, of a board that is held by hand."""
RANDOM_ORDERS = 20
MAX_TAKEN = 60
HARD = (24, 36)
"""Random poses, from and below, whose median sets the limit that is to be reached."""
MAX_ALL_SUBSETS = 20_000
SUBSETS, SUBSET, LARGER = 200, 6, 1.3
TASK = RobotTask("far", seen_by=("camera_1",), frame="camera_0_link", distance=2.0, limit_mm=1.0)
"""Task of the rig whose advice is timed."""
BEGUN = 5
"""Collections with which a recording that hides the others begins."""


def measure(quick: bool) -> Iterator[Row]:
    """Simulated robots of the systems that ship, with random starts; recordings that hide collections; time."""
    count = QUICK_ROBOTS if quick else ROBOTS
    begun = [each for k in range(count) if (each := begin(NAMES_OF_SYSTEMS[k % len(NAMES_OF_SYSTEMS)], k)) is not None]
    kept = [ratios for each in begun if (ratios := promised_over_reached(each))]
    broken = FlakeRate(sum(not all(RATIO_LIMITS[0] <= r <= RATIO_LIMITS[1] for r in each) for each in kept), len(kept))
    most, least = (100 * (1 - end) for end in broken.interval)
    every = np.concatenate(kept)
    low, middle, high = np.percentile(every, [5, 50, 95])
    quantiles = f"{low:.2f} {middle:.2f} {high:.2f}"
    note = f"{len(kept)} robots of five systems, {FOLLOWED_POSES} poses followed; 5, 50, 95 %: {quantiles}"
    note = f"{least:.1f} to {most:.1f} (95 %); {note}"
    yield Row("next_pose/promise kept", 100 * (1 - broken.share), "%", Bar(low=90), note)
    taken = np.array([poses for each in begun if (poses := poses_to_limit(each)) is not None], float)
    note = f"{len(taken)} robots; poses by advice {taken[:, 0].mean():.1f}, at random {taken[:, 1].mean():.1f}"
    yield Row("next_pose/poses, of random", float(taken[:, 0].sum() / taken[:, 1].sum()), "", Bar(high=0.5), note)
    note = f"best pair of all at each step: {taken[:, 2].mean():.1f}"
    yield Row("next_pose/poses, of best pairs", float(taken[:, 0].sum() / taken[:, 2].sum()), "", Bar(high=1.1), note)
    yield from _hidden()
    yield from _cost(quick)


@dataclass(frozen=True, eq=False)
class Begun:
    """Robot with a first recording, and an advisor."""

    system: System
    first: Motion
    pixels: float
    seed: int
    few: Calibration
    advisor: PoseAdvisor
    following: Motion
    """Through all candidates."""


@cache
def _system(name: str) -> tuple[System, Motion]:
    system = read_system(SYSTEMS_FOLDER / name)
    return system, find_candidates(system, 20, 5).motion


def begin(name: str, seed: int) -> Begun | None:
    """A first recording of 6 to 11 random poses with 0.05 to 0.5 px; None if it does not calibrate."""
    system, motion = _system(name)
    random = np.random.default_rng([seed, 1])
    first = motion.take(random.choice(len(motion), int(random.integers(6, 12)), replace=False))
    pixels = float(np.exp(random.uniform(np.log(0.05), np.log(0.5))))
    try:
        few = calibrate(_recorded(system, first, pixels, seed), _options(seed))
    except CalibrationError:
        return None
    candidates = candidates_of(few, system.nominal, seed, MAX_TAKEN)
    following = motion_of(candidates, range(len(candidates)), system.T_model_pattern)
    if following is None or not len(candidates):
        return None
    sigmas = list(stated(few).values())
    limits = Limits(
        translation_mm=min(mm for mm, _ in sigmas if mm > 0) * random.uniform(0.5, 2),
        rotation_deg=min(deg for _, deg in sigmas if deg > 0) * random.uniform(0.5, 2),
    )
    advisor = pose_advisor(few, candidates.dataset, limits)
    return Begun(system, first, pixels, seed, few, advisor, following)


def _options(seed: int) -> Options:
    """Return how well a robot's fixed parameters are known: as usual, or exactly in every other robot of a system."""
    return Options(assume=ALL_EXACT if seed // len(NAMES_OF_SYSTEMS) % 2 else Assumptions())


def _recorded(system: System, motion: Motion, pixels: float, seed: int) -> Dataset:
    """The dataset of a motion, with noise."""
    random = np.random.default_rng([seed, 2])
    exact = expected_dataset(system, place(system, motion))

    def noisy(key: tuple[str, str], label: Labels) -> Labels:
        if isinstance(label, CornerLabels):
            return replace(label, pixels=label.pixels + random.normal(0, pixels, label.pixels.shape))
        if isinstance(label, PointLabels):
            lengths = np.linalg.norm(label.points, axis=1, keepdims=True)
            off = random.normal(0, system.sensors[key[1]].noise, lengths.shape)
            return replace(label, points=label.points * (1 + off / lengths))
        return label

    return replace(
        exact,
        collections=tuple(
            Collection(each.key, {key: noisy(key, label) for key, label in each.labels.items()})
            for each in exact.collections
        ),
    )


def promised_over_reached(begun: Begun) -> list[float]:
    """Return the ratio of each goal, once the advised poses are taken as exactly as a hand holds a board."""
    advice = begun.advisor.advise(FOLLOWED_POSES)
    more = begun.following.take([pose.candidate for pose in advice.poses])
    if more.model_poses is not None:
        random = np.random.default_rng([begun.seed, 3])
        size = (len(more), 3)
        off = np.concatenate([random.normal(0, HAND_MM / 1e3, size), random.normal(0, np.radians(HAND_DEG), size)], 1)
        more = moving_model(retract(more.model_poses, off))
    try:
        both = joined([begun.first, more])
        recorded = _recorded(begun.system, both, begun.pixels, begun.seed)
        reached = stated(calibrate(recorded, _options(begun.seed)))
    except CalibrationError:
        return [np.inf]
    return [
        float(size) / reached[goal.name][0 if goal.unit == "mm" else 1]
        for goal, size in zip(advice.goals, advice.poses[-1].sizes, strict=True)
    ]


def poses_to_limit(begun: Begun) -> tuple[float, float, float] | None:
    """Poses by advice, at random, and by the best pair at each step, to what random orders reach with many."""
    random = np.random.default_rng([begun.seed, 4])
    knowledge, information, goal = begun.advisor.knowledge, begun.advisor.candidates, begun.advisor.goals[0]
    if len(information) < MAX_TAKEN:
        return None
    orders = [random.permutation(len(information))[:MAX_TAKEN] for _ in range(RANDOM_ORDERS)]
    curves = np.array([_sizes_along(knowledge, information, goal, order) for order in orders])
    wanted = float(np.median(curves[:, int(random.integers(*HARD))]))
    if wanted >= float(np.sqrt(knowledge.variances(goal.rows[0]).sum())):
        return None  # of what is held, no pose mends anything
    at_random = [int(np.argmax(curve <= wanted)) + 1 if (curve <= wanted).any() else MAX_TAKEN for curve in curves]
    sought = PoseAdvisor(knowledge, (replace(goal, wanted=wanted),), information)
    needed = sought.advise(1, MAX_TAKEN).needed or MAX_TAKEN
    return float(needed), float(np.mean(at_random)), float(_by_pairs(knowledge, information, goal, wanted))


def _sizes_along(knowledge: Knowledge, information: Array, goal: Goal, order: IntArray) -> Array:
    added = np.cumsum(information[order], axis=0)
    return np.asarray(np.sqrt(knowledge.variances(goal.rows[0], added).sum(-1)))


def _by_pairs(knowledge: Knowledge, information: Array, goal: Goal, wanted: float) -> int:
    """Poses if at each step the best of all pairs is taken: of a single one where that is enough."""
    for taken in range(0, MAX_TAKEN, 2):
        alone = np.sqrt(knowledge.variances(goal.rows[0], information).sum(-1))
        if alone.min() <= wanted:
            return taken + 1
        i, j = np.triu_indices(len(information), 1)
        sums = np.concatenate(
            [knowledge.variances(goal.rows[0], information[a] + information[b]).sum(-1) for a, b in _parts(i, j)]
        )
        best = int(sums.argmin())
        if np.sqrt(sums[best]) <= wanted:
            return taken + 2
        knowledge = knowledge.with_views(information[i[best]] + information[j[best]])
        information = np.delete(information, [i[best], j[best]], axis=0)
    return MAX_TAKEN


def _parts(i: IntArray, j: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    for start in range(0, len(i), 500):
        yield i[start : start + 500], j[start : start + 500]


def _hidden() -> Iterator[Row]:
    """Recordings that hide all but a few collections, and reveal those that are advised."""
    for name, reason in (("t2rgb-paper", missing("t2rgb-paper")), ("real-arm", NO_ARM)):
        row = f"next_pose/{name}, of best subset"
        try:
            dataset = load(name) if name == "t2rgb-paper" else real_arm()
        except (OSError, CalibrationError):
            yield Row(row, skipped=reason)
            continue
        yield _revealed(row, dataset)


def _revealed(row: str, dataset: Dataset) -> Row:
    full = calibrate(dataset)
    used = full.solution.dataset
    random = np.random.default_rng(1)
    ratios, possible, count = list[float](), list[float](), SUBSET
    for _ in range(20):
        start = random.choice(len(used.collections), BEGUN, replace=False)
        others = np.setdiff1d(np.arange(len(used.collections)), start)
        try:
            few = calibrate(dataset.with_collections(start.tolist()))
        except CalibrationError:
            continue
        advisor = pose_advisor(few, used.with_collections(others.tolist()), Limits(translation_mm=1e-6))
        count = min(SUBSET, int(len(others) / LARGER) - 1)
        chosen = [pose.candidate for pose in advisor.advise(count, count).poses]
        size = _judge(full, start, others, advisor.goals[0])
        larger = [random.choice(len(others), round(LARGER * count), replace=False).tolist() for _ in range(SUBSETS)]
        best = min(map(size, larger))
        ratios.append(size(chosen) / best)
        if math.comb(len(others), count) <= MAX_ALL_SUBSETS:
            possible.append(min(map(size, itertools.combinations(range(len(others)), count))) / best)
    note = (
        f"{count} advised against the best of {SUBSETS} random subsets of {LARGER} times as many, {len(ratios)} starts"
    )
    of_all = f"; the best of all subsets of {count}: {np.median(possible):.3f}" if possible else ""
    return Row(row, float(np.median(ratios)), "", Bar(high=1.0), f"{note}; worst {max(ratios):.2f}{of_all}")


def _judge(full: Calibration, start: IntArray, others: IntArray, goal: Goal) -> Callable[[Sequence[int]], float]:
    """Return the size of a goal's error by some of the others, as the calibration by all collections judges it."""
    judge = knowledge_of(full)
    each = judge.views(full.solution.dataset)
    own = replace(judge, information=judge.information - each.sum(0) + each[start].sum(0))

    def size(which: Sequence[int]) -> float:
        return float(np.sqrt(own.variances(goal.rows[0], each[others[list(which)]].sum(0)[None]).sum()))

    return size


def _cost(quick: bool) -> Iterator[Row]:
    """Time of tasks and advice beside a calibration."""
    for collections in (20, 2000):
        dataset, _ = rig(collections, seed=1)
        calibration = calibrate(dataset)
        whole = _seconds(partial(calibrate, dataset), 1 if quick or collections > 20 else 5)
        candidates = candidates_of(calibration).dataset

        def advise(calibration: Calibration = calibration, candidates: Dataset = candidates) -> None:
            errors = task_errors(calibration, [TASK])
            pose_advisor(calibration, candidates, Limits(translation_mm=1.0), errors).advise(3)

        spent = _seconds(advise, 3 if quick else 10)
        bar = Bar(high=50) if collections == 20 else None
        yield Row(
            f"next_pose/time at {collections}", 1e3 * spent, "ms", bar, f"a calibration takes {1e3 * whole:.0f} ms"
        )
        yield Row(f"next_pose/share at {collections}", spent / whole, "", Bar(high=0.5), "of the calibration's")


def _seconds(work: Callable[[], object], rounds: int) -> float:
    """Least processor time of some rounds."""
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)
