"""Goals of further poses: limits of sensors, joints and tasks, as the standard deviations that decide them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.limits import Limits, allowed, block_of, stated
from calibration.engine.diagnosis.precision import UNIT_NAMES
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.next_pose.knowledge import Knowledge
from calibration.engine.tasks.task_errors import TaskError

MIN_WANTED = 1e-9
"""mm, deg: least of what is wanted of an error; a limit may be 0."""
_UNIT_OF_PARAMETER = (("m", 1e3), ("rad", 180 / np.pi))


@dataclass(frozen=True, eq=False)
class Goal:
    """Error that is to be small enough for a limit to be decided."""

    name: str
    """Sensor, joint or task."""
    unit: str
    rows: Array
    """(r, F + H): its derivatives by the parameters of `Knowledge`, in its unit. Its size is the root of the sum of
    their variances: a standard deviation, or of a task the error that 95 % stay below."""
    wanted: float
    """Size at which its limit holds, in its unit."""
    limit: float
    """The limit."""


def goals_of(
    calibration: Calibration, knowledge: Knowledge, limits: Limits, tasks: Sequence[TaskError] = ()
) -> tuple[Goal, ...]:
    """Return the goals of a calibration that has converged: its limits, set or default, and those of its tasks."""
    goals = []
    for name in stated(calibration):
        limit = allowed(calibration, limits, name)
        block, units = block_of(calibration, name)
        at = calibration.solution.setup.problem.shared_parameters[block]
        for most, unit, (parameter, scale) in zip(
            (limit.translation_mm, limit.rotation_deg), UNIT_NAMES, _UNIT_OF_PARAMETER, strict=True
        ):
            own = np.arange(at.start, at.stop)[[each == parameter for each in units]]
            if np.isfinite(most) and len(own) and limits.guard:
                rows = np.zeros((len(own), len(knowledge.columns)))
                rows[np.arange(len(own)), own] = scale
                goals.append(Goal(name, unit, rows, max(most / limits.guard, MIN_WANTED), most))
    for error in tasks:
        if error.task.limit is not None:
            goals.append(_goal_of_task(error, error.task.limit, knowledge))
    return tuple(goals)


def _goal_of_task(error: TaskError, limit: float, knowledge: Knowledge) -> Goal:
    """Return the goal at the task's worst point, where the shape of its error is taken to stay."""
    rows = error.jacobian[error.worst][:, knowledge.columns]
    size = float(np.sqrt(knowledge.variances(rows).sum()))
    most = float(error.most[error.worst])
    return Goal(error.task.name, error.task.unit, rows * (most / size if size > 0 else 1.0), limit, limit)
