"""Goals of further poses: limits of sensors, joints and tasks, as the standard deviations that decide them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.limits import TWIST_UNITS, Limits, allowed, block_of, stated
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.next_pose.knowledge import Knowledge
from calibration.engine.tasks.robot_task import TaskUnit
from calibration.engine.tasks.task_errors import TaskError

MIN_WANTED = 1e-9
"""mm, deg: least of what is wanted of an error; a limit may be 0."""
MAX_POINTS = 6
"""Points of a task that are looked at."""
_UNITS: tuple[tuple[TaskUnit, str, float], ...] = (("mm", "m", 1e3), ("deg", "rad", 180 / np.pi))
"""Of limits, of the parameters, and their ratio."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Error that is to be small enough for a limit to be decided."""

    name: str
    """Sensor, joint or task."""
    unit: TaskUnit
    rows: Array
    """(p, r, F + H): its derivatives by the parameters of `Knowledge`, in its unit, at p points of a task, else at one.
    Its size is the root of the sum of their variances at the worst point: a standard deviation, or of a task the error
    that 95 % stay below."""
    wanted: float
    """Size at which its limit holds, in its unit."""
    limit: float
    """The limit."""


def goals_of(
    calibration: Calibration, knowledge: Knowledge, limits: Limits, tasks: Sequence[TaskError] = ()
) -> tuple[Goal, ...]:
    """Return the goals of a calibration that has converged: its limits, set or default, and those of its tasks."""
    goals: list[Goal] = []
    for name in stated(calibration):
        limit = allowed(calibration, limits, name)
        block, units = block_of(calibration, name)
        goals += _goals_of_block(
            name, (limit.translation_mm, limit.rotation_deg), limits.guard, knowledge, block, units
        )
    with_limit = ((error, error.task.limit) for error in tasks if error.task.limit is not None)
    return (*goals, *(_goal_of_task(error, limit, knowledge) for error, limit in with_limit))


def goals_before(knowledge: Knowledge, limits: Limits) -> tuple[Goal, ...]:
    """Return the goals of a calibration that is planned: its limits, or the least default ones if none is set."""
    setup = knowledge.solution.setup
    shared, goals = setup.problem.shared_parameters, list[Goal]()
    given = (limits.translation_mm, limits.rotation_deg, limits.joint_mm, limits.joint_deg)
    most = [np.inf if each is None else each for each in given] if limits.any_set else [*limits.sensor, *limits.joint]
    for sensor in setup.dataset.sensors.values():
        if (block := setup.block(sensor.edge)) in shared:
            goals += _goals_of_block(sensor.name, most[:2], limits.guard, knowledge, block, TWIST_UNITS)
    for name, joint in setup.dataset.joints.items():
        units = [joint.model.unit(parameter) for parameter in joint.parameters]
        goals += _goals_of_block(name, most[2:], limits.guard, knowledge, setup.block(joint.edge), units)
    return tuple(goals)


def _goals_of_block(
    name: str, most: Sequence[float], guard: float, knowledge: Knowledge, block: int, units: Sequence[str]
) -> Iterator[Goal]:
    """Yield the goals of a shared block: its lengths and its angles, as far as they have a limit."""
    at = knowledge.solution.setup.problem.shared_parameters[block]
    for limit, (unit, parameter, scale) in zip(most, _UNITS, strict=True):
        own = np.arange(at.start, at.stop)[[each == parameter for each in units]]
        if np.isfinite(limit) and len(own) and guard:
            rows = np.zeros((1, len(own), len(knowledge.columns)))
            rows[0, np.arange(len(own)), own] = scale
            yield Goal(name, unit, rows, max(limit / guard, MIN_WANTED), limit)


def _goal_of_task(error: TaskError, limit: float, knowledge: Knowledge) -> Goal:
    """Return the goal at some of a task's points, the worst one among them; the shape of its error is taken to stay."""
    some = np.linspace(0, len(error.most) - 1, MAX_POINTS - 1).round().astype(int)
    points = np.unique([error.worst, *some.tolist()])
    rows = error.jacobian[points][:, :, knowledge.columns]
    sizes = np.sqrt(knowledge.variances(rows.reshape(-1, rows.shape[-1]))[0].reshape(rows.shape[:2]).sum(1))
    scales = np.divide(error.most[points], sizes, out=np.ones(len(points)), where=sizes > 0)
    return Goal(error.task.name, error.task.unit, rows * scales[:, None, None], limit, limit)
