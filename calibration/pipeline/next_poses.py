"""What to record next: poses that can be had, what they are expected to bring, their files, and the report on them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.base import CalibrationError, InputError
from calibration.base.records import field, result
from calibration.ci.pages.html import bullets, element, page, section
from calibration.ci.report import Lines, Report, Table, shown
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.next_pose import Advice, Goal, next_poses
from calibration.engine.tasks.task_errors import TaskError, task_errors
from calibration.pipeline.matrix.loaded_system import LoadedSystem, described_robot, load
from calibration.pipeline.matrix.next_poses_result import NextGoal, NextPose, NextPoses, NextView
from calibration.pipeline.page.label_residuals import pose_figures
from calibration.pipeline.results import PAGE_FILE
from calibration.pipeline.system import System
from calibration.robot.next_pose.candidates import PoseCandidates, candidates_of
from calibration.robot.next_pose.plan import instruction, motion_of, patterns_in_view, plan_recording, poses_csv
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import motion_document
from calibration.robot.simulation.motion_generation import is_clear
from calibration.robot.simulation.system import SIMULATION_FILE, read_system
from calibration.robot.simulation.system import System as SimulatedSystem

MOTION_FILE, POSES_FILE = "next-poses.json", "next-poses.csv"
COUNT = 3
"""Poses that are advised, by default."""


@dataclass(frozen=True, eq=False)
class AdvisedPoses:
    """Advice with the poses that it is about, to write and draw them."""

    found: NextPoses
    candidates: PoseCandidates
    chosen: tuple[int, ...]
    system: SimulatedSystem | None
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
    calibration: Calibration, loaded: LoadedSystem, tasks: Sequence[TaskError], count: int = COUNT, seed: int = 1
) -> AdvisedPoses:
    """Return what to record next for a calibration that has converged.

    An arm moves within the limits of the robot's description, that of the exports or beside the dataset. In a recording
    that was simulated, no pose collides.

    Args:
        calibration: the calibration.
        loaded: its system, with the limits.
        tasks: errors of the robot's tasks; those with a limit count.
        count: number of poses.
        seed: of the poses that are looked at.

    Raises:
        InputError: the robot's description is wrong.
    """
    folder = loaded.dataset.path.parent
    system = _simulated_with(folder)
    robot = described_robot(folder, loaded.exports) or (system.nominal if system else None)
    candidates = candidates_of(calibration, robot, seed)
    if system is not None:
        candidates = _without_collisions(candidates, system)
    advice = next_poses(calibration, candidates.dataset, loaded.limits, tasks, count)
    remarks = tuple[str, ...]()
    if candidates.without_limits and len(candidates):
        names = ", ".join("-".join(edge) for edge in candidates.without_limits)
        remarks = (f"no joint limits are known of {names}: the poses are near those of the recording",)
    return replace(described_advice(advice, candidates, system, remarks), recording=loaded.dataset)


def plan(system: SimulatedSystem, limits: Limits, options: Options, count: int | None, seed: int) -> AdvisedPoses:
    """Return the poses of a recording that is planned; see `plan_recording`.

    Raises:
        InputError: nothing moves, or no pose is seen by every sensor.
    """
    return described_advice(*plan_recording(system, limits, options.assume, count, seed), system, planned=True)


def described_advice(
    advice: Advice,
    candidates: PoseCandidates,
    system: SimulatedSystem | None,
    remarks: tuple[str, ...] = (),
    planned: bool = False,
) -> AdvisedPoses:
    """Return advice in words and numbers, with the poses that it is about.

    Args:
        advice: the advice.
        candidates: the poses among which it chose.
        system: what the recording was simulated with, if it was.
        remarks: what was not known.
        planned: whether nothing is recorded yet.
    """
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


def _without_collisions(candidates: PoseCandidates, system: SimulatedSystem) -> PoseCandidates:
    """Return those at which nothing collides in a simulation."""
    motion = motion_of(candidates, range(len(candidates)), system.T_model_pattern) if len(candidates) else None
    if motion is None:
        return candidates
    placement = place(replace(system, robot=system.nominal), motion)
    free = placement.sensors_are_free(system.scene)
    for pattern in system.patterns.values():
        free &= is_clear(system, pattern, placement)
    return candidates.take(np.flatnonzero(free))


def _simulated_with(folder: Path) -> SimulatedSystem | None:
    """Return what a dataset in a folder was simulated with; None if it was not, or that is not all there."""
    try:
        return read_system(folder) if (folder / SIMULATION_FILE).is_file() else None
    except CalibrationError:
        return None


TITLE = "Next poses"


@result
class NextPosesOfSystems:
    """Results of next-pose and plan-recording."""

    systems: Mapping[str, NextPoses] = field("What to record next, by system.")


def advise_system(system: System, count: int, seed: int) -> AdvisedPoses:
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
    tasks = task_errors(calibration, loaded.tasks)
    advised = advise(calibration, loaded, tasks, count, seed)
    found = diagnose(calibration, loaded.dataset, loaded.options, loaded.limits, loaded.truth is not None, tasks)
    wrong = tuple(f"mend first: {each.text}" for each in found if each.severity == "red" and each.kind != "precision")
    return replace(advised, found=replace(advised.found, remarks=(*wrong, *advised.found.remarks)))


def next_poses_report(advised: Mapping[str, AdvisedPoses]) -> Report:
    """Return the report of poses to take next, by system."""
    alone = len(advised) == 1
    files = {
        name if alone else f"{system}-{name}": text_
        for system, each in advised.items()
        for name, text_ in each.files.items()
    }
    sections = [
        section(system, bullets(each.found.lines), pose_figures(each, each.recording))
        for system, each in advised.items()
    ]
    goals = Table(
        ("System", "Limit of", "Limit", "Decided at", "Now", "At best"),
        tuple(
            (
                system,
                goal.name,
                *(shown(v, ".3g", goal.unit) for v in (goal.limit, goal.wanted, goal.now, goal.least)),
            )
            for system, each in advised.items()
            for goal in each.found.goals
        ),
    )
    lines = tuple(line if alone else f"{name}: {line}" for name, each in advised.items() for line in each.found.lines)
    return Report(
        title=TITLE,
        verdict="pass",
        judges=False,
        sentence="; ".join(
            each.found.sentence if alone else f"{name}: {each.found.sentence}" for name, each in advised.items()
        ),
        results=NextPosesOfSystems({name: each.found for name, each in advised.items()}),
        blocks=(goals, Lines(lines, title="What to record")),
        files={**files, PAGE_FILE: page(TITLE, [element("h1", TITLE), *sections])},
    )
