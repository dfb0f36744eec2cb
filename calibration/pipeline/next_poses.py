"""What to record next for a calibration: poses that can be had, what they are expected to bring, and their files."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.base.errors import CalibrationError, InputError
from calibration.base.records import field, result
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.next_pose.advice import Advice, next_poses
from calibration.engine.next_pose.goals import Goal
from calibration.engine.tasks.task_errors import TaskError
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.system import System as Configured
from calibration.robot.next_pose.candidates import PoseCandidates, candidates_of
from calibration.robot.next_pose.instructions import instruction, motion_of, patterns_in_view, poses_csv
from calibration.robot.next_pose.plan import plan_recording
from calibration.robot.simulation.motion.generation import is_clear
from calibration.robot.simulation.motion.sequence import motion_document
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.system import ROBOT_FILE, SIMULATION_FILE, System, read_system
from calibration.robot.urdf import Robot, read_robot

MOTION_FILE, POSES_FILE = "next-poses.json", "next-poses.csv"
COUNT = 3
"""Poses that are advised, by default."""


@result
class NextGoal:
    """Limit that further poses are to decide."""

    name: str = field("Sensor, joint or task.")
    unit: str = field("Of its sizes.")
    limit: float = field("The limit.")
    wanted: float = field("Standard deviation that decides it; of a task the limit itself.")
    now: float | None = field(
        "Standard deviation, in all; of a task the error that 95 % stay below. Null before anything is recorded."
    )
    least: float = field("The same with any number of poses.")


@result
class NextView:
    """Pattern in a camera's view, at a pose."""

    camera: str = field("The camera.")
    pattern: str = field("The pattern.")
    outline: tuple[tuple[int, int], ...] = field("Its border in the image.", unit="px")


@result
class NextPose:
    """Pose to take next, after those before it."""

    text: str = field("What to do.")
    joints: Mapping[str, float] = field("Positions of the joints, rad or m, where the robot is described.")
    views: tuple[NextView, ...] = field("What the cameras see there.")
    sizes: tuple[float, ...] = field("Expected size of each goal's error after it.")


@result
class NextPoses:
    """Advice on what to record next."""

    goals: tuple[NextGoal, ...] = field("The limits.")
    poses: tuple[NextPose, ...] = field("The poses, best first.", default=())
    needed: int | None = field("Poses after which all limits hold; null if no number of them does it.", default=None)
    beyond_poses: Mapping[str, float] = field("Shares of what poses cannot mend, by cause.", default_factory=dict)
    remarks: tuple[str, ...] = field("What was not known.", default=())

    @property
    def open_goals(self) -> tuple[int, ...]:
        """The limits that are not decided yet."""
        return tuple(k for k, goal in enumerate(self.goals) if goal.now is None or goal.now > goal.wanted)

    @property
    def lines(self) -> tuple[str, ...]:
        """The advice in words: the poses, what they bring, how many it takes, and what no pose can mend."""
        shown = self.open_goals or tuple(range(len(self.goals)))[:1]
        poses = [f"{k}. {pose.text}: {self._changes(shown, k)}" for k, pose in enumerate(self.poses, 1)]
        return (*(poses if self.open_goals else ()), self.sentence, *self.remarks)

    def _changes(self, shown: Sequence[int], number: int) -> str:
        before = tuple(goal.now for goal in self.goals) if number == 1 else self.poses[number - 2].sizes
        after = self.poses[number - 1].sizes
        return ", ".join(
            f"{self.goals[k].name} {'' if (old := before[k]) is None else f'{old:.3g} -> '}{after[k]:.3g} "
            f"{self.goals[k].unit}"
            for k in shown
        )

    @property
    def sentence(self) -> str:
        """How many poses it takes, or that none can do it, or that it is enough."""
        if not self.open_goals:
            brings = max((1 - size / goal.now if goal.now else 0.0 for size, goal in self._last), default=0.0)
            said = f"{len(self.poses)} further poses would bring {max(0.0, brings):.0%}" if self.poses else ""
            return f"enough: all limits hold{f'; {said}' if said else ''}"
        worst = max(self.open_goals, key=lambda k: self.goals[k].least / self.goals[k].wanted)
        goal = self.goals[worst]
        if not self.poses:
            return (
                f"no pose can mend it: nothing moves between sensors and patterns, or no sensor would see it "
                f"({goal.name} {goal.now or 0:.2g} {goal.unit}, {goal.wanted:.2g} would decide its limit)"
            )
        if self.needed is not None:
            more = self.needed - len(self.poses)
            also = f"{more} more such and " if more > 0 else ""
            return f"{also}the limit of {goal.limit:.3g} {goal.unit} holds: {self.needed} poses in all"
        causes = ", ".join(f"{share:.0%} {name}" for name, share in list(self.beyond_poses.items())[:3])
        of = f": of that is {causes}" if causes else ""
        end = "calibrate it, or state under 'assume' how well it is known" if causes else "take poses from nearer"
        return (
            f"no number of such poses decides the limit of {goal.limit:.3g} {goal.unit}: {goal.name} stays at "
            f"{goal.least:.2g}, {goal.wanted:.2g} is needed{of}; {end}"
        )

    @property
    def _last(self) -> Sequence[tuple[float, NextGoal]]:
        """What the last pose brings to each goal."""
        return list(zip(self.poses[-1].sizes, self.goals, strict=True)) if self.poses else []


@dataclass(frozen=True, eq=False)
class AdvisedPoses:
    """Advice with the poses that it is about, to write and draw them."""

    found: NextPoses
    candidates: PoseCandidates
    chosen: tuple[int, ...]
    system: System | None
    recording: Dataset | None = None
    """The recording, with its images."""

    @cached_property
    def files(self) -> Mapping[str, str]:
        """Texts of the files, by name: positions and transforms, and a motion where it can be played."""
        if not self.chosen:
            return {}
        T = None if self.system is None else self.system.T_model_pattern
        motion = motion_of(self.candidates, self.chosen, T)
        files = {POSES_FILE: poses_csv(self.candidates, self.chosen)}
        return files if motion is None else files | {MOTION_FILE: json.dumps(motion_document(motion), indent=1) + "\n"}


def advise(
    calibration: Calibration,
    limits: Limits,
    robot: Robot | None = None,
    system: System | None = None,
    tasks: Sequence[TaskError] = (),
    count: int = COUNT,
    seed: int = 1,
) -> AdvisedPoses:
    """Return what to record next for a calibration that has converged.

    Args:
        calibration: the calibration.
        limits: those that the user has set; without any, the default ones.
        robot: the robot's description, for the limits of its joints and where an arm can reach.
        system: what the recording was simulated with: then no pose collides.
        tasks: errors of the robot's tasks; those with a limit count.
        count: number of poses.
        seed: of the poses that are looked at.
    """
    candidates = candidates_of(calibration, robot or (system.nominal if system else None), seed)
    if system is not None:
        candidates = _without_collisions(candidates, system)
    advice = next_poses(calibration, candidates.dataset, limits, tasks, count)
    remarks = tuple[str, ...]()
    if candidates.without_limits and len(candidates):
        names = ", ".join("-".join(edge) for edge in candidates.without_limits)
        remarks = (f"no joint limits are known of {names}: the poses are near those of the recording",)
    return _described(advice, candidates, system, remarks)


def plan(system: System, limits: Limits, options: Options, count: int | None, seed: int) -> AdvisedPoses:
    """Return the poses of a recording that is planned; see `plan_recording`.

    Raises:
        InputError: nothing moves, or no pose is seen by every sensor.
    """
    return _described(*plan_recording(system, limits, options.assume, count, seed), system, planned=True)


def _described(
    advice: Advice,
    candidates: PoseCandidates,
    system: System | None,
    remarks: tuple[str, ...] = (),
    planned: bool = False,
) -> AdvisedPoses:
    chosen = [each.candidate for each in advice.poses]
    found = NextPoses(
        _goals_found(advice, planned),
        tuple(
            NextPose(
                instruction(candidates, each.candidate),
                {name: round(float(at[each.candidate]), 6) for name, at in candidates.joints.items()},
                tuple(
                    NextView(view.camera, view.pattern, tuple((round(u), round(v)) for u, v in view.outline.tolist()))
                    for view in patterns_in_view(candidates.dataset, each.candidate)
                ),
                _rounded(each.sizes.tolist()),
            )
            for each in advice.poses
        ),
        advice.needed,
        {name: round(share, 4) for name, share in advice.beyond_poses.items()},
        remarks,
    )
    return AdvisedPoses(found, candidates, tuple(chosen), system)


def _goals_found(advice: Advice, planned: bool) -> tuple[NextGoal, ...]:
    def goal(each: Goal, now: float, least: float) -> NextGoal:
        limit, wanted, now, least = _rounded([each.limit, each.wanted, now, least])
        return NextGoal(each.name, each.unit, limit, wanted, None if planned else now, least)

    rows = zip(advice.goals, advice.sizes.tolist(), advice.least.tolist(), strict=True)
    return tuple(goal(*row) for row in rows)


def _rounded(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(f"{value:.5g}") for value in values)


def _without_collisions(candidates: PoseCandidates, system: System) -> PoseCandidates:
    """Return those at which nothing collides in a simulation."""
    motion = motion_of(candidates, range(len(candidates)), system.T_model_pattern) if len(candidates) else None
    if motion is None:
        return candidates
    placement = place(replace(system, robot=system.nominal), motion)
    free = placement.sensors_are_free(system.scene)
    for pattern in system.patterns.values():
        free &= is_clear(system, pattern, placement)
    return candidates.take(np.flatnonzero(free))


def description_beside(dataset: Path) -> tuple[Robot | None, System | None]:
    """Return the robot's description beside a dataset, and what it was simulated with; None without them.

    Args:
        dataset: the dataset's file.
    """
    folder = dataset.parent
    try:
        system = read_system(folder) if (folder / SIMULATION_FILE).is_file() else None
        return (read_robot(folder / ROBOT_FILE) if (folder / ROBOT_FILE).is_file() else None), system
    except CalibrationError:
        return None, None


def advise_system(system: Configured, count: int, seed: int) -> AdvisedPoses:
    """Calibrate a configured system, and return what to record next for its limits.

    Raises:
        InputError: its dataset is collected in a run only, or cannot be calibrated.
    """
    if system.collected is not None:
        raise InputError(f"{system.name}: its dataset is collected in each run: give the folder of a recording")
    loaded = load(system)
    calibration = loaded.prepared.optimum
    if not calibration.converged:
        raise InputError(f"{loaded.dataset.path}: no advice: it does not calibrate: {calibration.reason}")
    robot, simulated = description_beside(loaded.dataset.path)
    if system.exports is not None and system.exports.robot_description is not None:
        robot = read_robot(system.exports.robot_description, system.exports.xacro)
    advised = advise(calibration, system.limits, robot, simulated, count=count, seed=seed)
    found = diagnose(calibration, loaded.dataset, loaded.options, loaded.limits, loaded.truth is not None)
    wrong = tuple(f"mend first: {each.text}" for each in found if each.severity == "red" and each.kind != "precision")
    return replace(
        advised, recording=loaded.dataset, found=replace(advised.found, remarks=(*wrong, *advised.found.remarks))
    )
