"""Robot of a system by its description, and its poses at work."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.tasks.robot_task import RobotTask, WorkPoses
from calibration.robot.simulation.system import ROBOT_FILE
from calibration.robot.urdf import Robot, compose, read_robot

if TYPE_CHECKING:
    from calibration.pipeline.system import Exports


def described_robot(folder: Path, exports: "Exports | None") -> Robot | None:
    """Return the robot by the description of its exports, else by that beside its dataset; None if there is none.

    Args:
        folder: of the dataset.
        exports: of the system.

    Raises:
        InputError: the description is wrong.
        InfrastructureError: it is a xacro, and what expands it is not installed.
    """
    if exports is not None and exports.robot_description is not None:
        return read_robot(exports.robot_description, exports.xacro)
    return read_robot(folder / ROBOT_FILE) if (folder / ROBOT_FILE).is_file() else None


def work_poses(task: RobotTask, dataset: Dataset, robot: Robot | None) -> WorkPoses:
    """Return the poses of a task's joints: the dataset's transforms between links of the robot that these move.

    Raises:
        InputError: there is no description, it has not such a joint, or a position is beyond its limits.
    """
    given, where = task.joints or {}, f"tasks.{task.name}.joints"
    if robot is None:
        raise InputError(
            f"{where}: found no description of the robot, expected {ROBOT_FILE} beside {dataset.path.name}, or "
            "exports: {robot-description: ...}"
        )
    try:
        all_of = robot.transforms({name: np.array(at) for name, at in given.items()})
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    transforms, positions, others = {}, {}, {}
    for edge in dataset.transforms:
        if not set(edge) <= set(robot.tree.frames):
            continue
        steps = [robot.by_edge[step.parent, step.child] for step in robot.tree.path(*edge)]
        moving = [joint for joint in steps if joint.is_movable]
        if unknown := tuple(joint.driver for joint in moving if joint.driver not in given):
            others[edge] = unknown
        elif moving:
            transforms[edge] = compose(robot.tree, all_of, *edge)
            if len(steps) == 1:
                driven = np.array(given[moving[0].driver])
                positions[edge] = driven if (mimic := moving[0].mimic) is None else mimic.positions(driven)
    return WorkPoses(len(next(iter(given.values()))), transforms, positions, others)
