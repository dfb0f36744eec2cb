"""What to record next for a calibration: poses that can be had, what they are expected to bring, and their files."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.base import CalibrationError
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.next_pose import Advice, Goal, next_poses
from calibration.engine.tasks.task_errors import TaskError
from calibration.pipeline.matrix.described_robot import described_robot
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.next_poses_result import NextGoal, NextPose, NextPoses, NextView
from calibration.robot.next_pose.candidates import PoseCandidates, candidates_of
from calibration.robot.next_pose.plan import instruction, motion_of, patterns_in_view, plan_recording, poses_csv
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import motion_document
from calibration.robot.simulation.motion_generation import is_clear
from calibration.robot.simulation.system import SIMULATION_FILE, System, read_system

MOTION_FILE, POSES_FILE = "next-poses.json", "next-poses.csv"
COUNT = 3
"""Poses that are advised, by default."""


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


def plan(system: System, limits: Limits, options: Options, count: int | None, seed: int) -> AdvisedPoses:
    """Return the poses of a recording that is planned; see `plan_recording`.

    Raises:
        InputError: nothing moves, or no pose is seen by every sensor.
    """
    return described_advice(*plan_recording(system, limits, options.assume, count, seed), system, planned=True)


def described_advice(
    advice: Advice,
    candidates: PoseCandidates,
    system: System | None,
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


def _simulated_with(folder: Path) -> System | None:
    """Return what a dataset in a folder was simulated with; None if it was not, or that is not all there."""
    try:
        return read_system(folder) if (folder / SIMULATION_FILE).is_file() else None
    except CalibrationError:
        return None
