"""Plan of a recording before anything is recorded: from a robot's description and its sensors."""

from dataclasses import replace

import numpy as np

from calibration.base import InputError
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.calibrated import calibrated_dataset
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.start.build import build
from calibration.engine.next_pose import Advice, PoseAdvisor, goals_before, knowledge_before
from calibration.robot.next_pose.candidates import PoseCandidates
from calibration.robot.simulation.motion.generation import find_candidates
from calibration.robot.simulation.motion.information import expected_dataset, expected_noise, true_values
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.system import System

LOOKED_AT = 10
"""Motions of this many poses have the number of candidates that are looked at (`find_candidates`)."""
MOST_PLANNED = 40
"""Poses that are planned at most."""
MIN_PLANNED = 8
"""Fewest poses of a plan: of fewer, no calibration can tell that something does not fit."""


def plan_recording(
    system: System, limits: Limits, assume: Assumptions | None = None, count: int | None = None, seed: int = 1
) -> tuple[Advice, PoseCandidates]:
    """Return the poses that decide all limits soonest, and those among which they were chosen.

    Args:
        system: the robot and its sensors; nominal poses are enough.
        limits: those to be decided; the least default ones where none is set.
        assume: how well what is held is known; the usual if None.
        count: number of poses; as many as the limits take, up to `MOST_PLANNED`, if None.
        seed: of the poses that are looked at.

    Raises:
        InputError: no camera, nothing moves, or no pose is seen by every sensor.
        UndeterminedError: no poses can calibrate the system.
    """
    nominal = replace(system, robot=system.nominal, joint_errors={})
    if not nominal.cameras:
        raise InputError(f"{system.name}: found no camera, expected one before which poses can be planned")
    motion = find_candidates(nominal, LOOKED_AT, seed).motion
    if not len(motion):
        raise InputError(
            f"{system.name}: no pose can be planned: at none every sensor sees a pattern; widen distance_m, tilt_deg "
            "or roll_deg under motion in its simulation.yml"
        )
    placement = place(nominal, motion)
    setup = build(expected_dataset(nominal, placement))
    poses = np.array([int(key) for key in setup.dataset.keys])
    values = true_values(nominal, setup, placement, poses)
    dataset = calibrated_dataset(setup, values, setup.dataset)
    solution = Solution(setup, values, expected_noise(nominal), dataset, assume or Assumptions())
    knowledge = knowledge_before(solution)
    advisor = PoseAdvisor(knowledge, goals_before(knowledge, limits), knowledge.views(dataset))
    advice = advisor.advise(count or MIN_PLANNED, max(count or 0, MOST_PLANNED))
    if count is None and advice.needed is not None:
        advice = advisor.advise(min(max(advice.needed, MIN_PLANNED), MOST_PLANNED), MOST_PLANNED)
    moved = nominal.moved_pattern
    edges = [joint.edge for joint in nominal.robot.movable.values()] if moved is None else [moved.edge]
    some = motion.take(poses)
    return advice, PoseCandidates(dataset, poses, some.joints, tuple(edges), moved is not None, ())
