"""Plan of a recording before anything is recorded, from the robot and its sensors; and what to do for a pose.

A pose is told in words; poses also as a motion file, joint positions and transforms.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.calibrated import calibrated_dataset
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.rotations import to_quaternion
from calibration.engine.geometry.transforms import apply, inverse
from calibration.engine.next_pose import Advice, PoseAdvisor, goals_before, knowledge_before
from calibration.robot.next_pose.candidates import PoseCandidates
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion, moving_joints, moving_model
from calibration.robot.simulation.motion_generation import find_candidates
from calibration.robot.simulation.motion_information import expected_dataset, expected_noise, true_values
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


MIN_TILT, MIN_ROLL = 8.0, 20.0
"""deg: smallest tilt and turn that are worth saying."""
COLUMN_NAMES, ROW_NAMES = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass(frozen=True, eq=False)
class PatternInView:
    """Pattern in a camera's view, at a pose."""

    camera: str
    pattern: str
    distance: float
    """m: of its centre."""
    place: str
    """Where in the image it is, such as "top right"."""
    tilt: float
    """deg, between its normal and the line of sight."""
    away: str
    """Its side in the image that is farther away; empty if it is not tilted."""
    roll: float
    """deg: turn about the line of sight, clockwise from upright."""
    outline: Array
    """(4, 2): its border in the image, px."""

    def __str__(self) -> str:
        place = f"in the {self.place}" if self.place == "middle" else f"at the {self.place}"
        tilt = f", its {self.away} tilted {self.tilt:.0f} degrees away" if self.away else ", facing the camera"
        turn = "clockwise" if self.roll > 0 else "anticlockwise"
        roll = f", turned {abs(self.roll):.0f} degrees {turn}" if abs(self.roll) > MIN_ROLL else ""
        return f"{self.distance:.2g} m before {self.camera}, {place} of its image{tilt}{roll}"


def patterns_in_view(dataset: Dataset, pose: int) -> Iterator[PatternInView]:
    """Yield the patterns that the cameras are expected to see at a pose, by its index."""
    for pattern_name, sensor_name in dataset.collections[pose].labels:
        sensor, pattern = dataset.sensors[sensor_name], dataset.patterns[pattern_name]
        if sensor.camera is not None:
            T = dataset.transform(sensor.frame, pattern.link, np.array([pose]))[0]
            yield _in_view(sensor_name, sensor.camera, pattern, T)


def _in_view(name: str, camera: Camera, pattern: Pattern, T: Array) -> PatternInView:
    centre = apply(T, pattern.centre[None])[0]
    distance = float(np.linalg.norm(centre))
    (u, v) = camera.project(centre[None])[0].tolist()
    column, row = (min(2, max(0, int(3 * at / size))) for at, size in ((u, camera.width), (v, camera.height)))
    place = f"{ROW_NAMES[row]} {COLUMN_NAMES[column]}" if row != 1 or column != 1 else "middle"
    normal, sight = T[:3, 2], centre / distance
    tilt = float(np.degrees(np.arccos(np.clip(normal @ sight, -1, 1))))
    across = normal - (normal @ sight) * sight
    sides = (("left side", across[0]), ("right side", -across[0]), ("top", across[1]), ("bottom", -across[1]))
    away = max(sides, key=lambda each: each[1])[0] if tilt > MIN_TILT else ""
    border = np.column_stack([pattern.outline, np.zeros(len(pattern.outline))])
    roll = float(np.degrees(np.arctan2(T[1, 0], T[0, 0])))
    return PatternInView(name, pattern.name, distance, place, tilt, away, roll, camera.project(apply(T, border)))


def instruction(candidates: PoseCandidates, pose: int) -> str:
    """Return in words what to do to take a pose, by its index among the candidates."""
    seen = list(patterns_in_view(candidates.dataset, pose))
    first = min(seen, key=lambda each: each.distance, default=None)
    if candidates.by_hand:
        return f"hold the board {first}" if first else "hold the board as its transform says"
    joints = ", ".join(f"{name} {float(at[pose]):.4g}" for name, at in candidates.joints.items())
    moved = f"move the joints to {joints}" if joints else f"move {', '.join('-'.join(e) for e in candidates.moved)}"
    return f"{moved}: the board is then {first}" if first else moved


def motion_of(candidates: PoseCandidates, poses: Sequence[int], T_model_pattern: Array | None = None) -> Motion | None:
    """Return the motion through some poses, by their indices; None of a robot without a description.

    Args:
        candidates: the candidates.
        poses: their indices.
        T_model_pattern: (4, 4): pose of a board on the model that a player moves; where they are the same if None.
    """
    if candidates.by_hand:
        T = candidates.dataset.transforms[candidates.moved[0]][list(poses)]
        return moving_model(T if T_model_pattern is None else T @ inverse(T_model_pattern))
    if not candidates.joints:
        return None
    return moving_joints({name: at[list(poses)] for name, at in candidates.joints.items()})


def poses_csv(candidates: PoseCandidates, poses: Sequence[int]) -> str:
    """Return a table of some poses: joint positions (rad or m), and all that moves as x, y, z, qx, qy, qz, qw."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    edges = ["-".join(edge) for edge in candidates.moved]
    columns = [f"{edge} {axis}" for edge in edges for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    writer.writerow(["pose", *candidates.joints, *columns])
    for number, pose in enumerate(poses, 1):
        own = [f"{float(at[pose]):.6f}" for at in candidates.joints.values()]
        writer.writerow([number, *own, *(n for edge in candidates.moved for n in _numbers(candidates, edge, pose))])
    return out.getvalue()


def _numbers(candidates: PoseCandidates, edge: Edge, pose: int) -> list[str]:
    T = candidates.dataset.transforms[edge][pose]
    return [f"{value:.6f}" for value in (*T[:3, 3].tolist(), *to_quaternion(T[:3, :3]).tolist())]
