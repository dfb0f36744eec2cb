"""Error of robot tasks at a calibration, by the delta method, split by what it comes from.

The error of a task at a point is ``e = J d``, with its derivatives J by all parameters (`placed_task.task_jacobian`)
and the errors d of these, calibrated and held, as independent ones of one standard deviation each
(`covariance.error_bars.ErrorSource`). So its covariance is the sum over these sources, and what is held counts both by
what it does to the calibrated parameters and by what it does itself: a focal length that is off moves the camera, and
the two nearly cancel where the patterns were.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.estimation.covariance.error_bars import ErrorSource, SourceKind
from calibration.engine.estimation.covariance.result import Calibration, Solution
from calibration.engine.tasks.gaussian_norm import quantile_of_norm, size_without_error
from calibration.engine.tasks.placed_task import PlacedTask, place_task, task_jacobian
from calibration.engine.tasks.robot_task import RobotTask

MEDIAN, MOST = 0.5, 0.95
"""Probabilities of the quantiles that are stated."""


@dataclass(frozen=True, eq=False)
class TaskError:
    """Error of a task at its n points, in its unit."""

    placed: PlacedTask
    jacobian: Array
    """(n, m, C): derivatives by the columns of the linear model."""
    sources: tuple[ErrorSource, ...]

    @property
    def task(self) -> RobotTask:
        """The task."""
        return self.placed.task

    @cached_property
    def variances(self) -> Mapping[str, Array]:
        """By source, its part (n,) of the mean square error."""
        return {each.name: ((self.jacobian @ each.columns) ** 2).sum((1, 2)) for each in self.sources}

    @cached_property
    def covariance(self) -> Array:
        """(n, m, m)."""
        moved = self.jacobian @ np.concatenate([each.columns for each in self.sources], 1)
        return np.asarray(moved @ np.swapaxes(moved, 1, 2))

    @cached_property
    def median(self) -> Array:
        """(n,): the size that the error does not exceed with a probability of one half."""
        return quantile_of_norm(self.covariance, MEDIAN)

    @cached_property
    def most(self) -> Array:
        """(n,): the size that it does not exceed with a probability of 95 %."""
        return quantile_of_norm(self.covariance, MOST)

    @cached_property
    def worst(self) -> int:
        """Number of the point with the largest error."""
        return int(self.most.argmax())

    def parts(self) -> dict[SourceKind, float]:
        """Return by kind of source its standard deviation at the worst point, largest first."""
        sums: dict[SourceKind, float] = {}
        for each in self.sources:
            moved = self.jacobian[self.worst] @ each.columns
            sums[each.kind] = sums.get(each.kind, 0.0) + float((moved**2).sum())
        return {kind: part**0.5 for kind, part in sorted(sums.items(), key=lambda each: -each[1]) if part > 0}

    def largest_change(self, changes: Array, errors: Array | None = None) -> float:
        """Return how far changes (C,) of all parameters, calibrated and held, move it at the worst point for them.

        Without what their independent errors (C, r) make it longer, if they are given.
        """
        sizes = np.linalg.norm(self.jacobian @ changes, axis=1)
        J = self.jacobian[int(sizes.argmax())]
        return float(sizes.max()) if errors is None else size_without_error(J @ changes, J @ errors)


def task_errors(calibration: Calibration, tasks: Sequence[RobotTask]) -> list[TaskError]:
    """Return the errors of tasks at a calibration that has converged; none of one that has not.

    Raises:
        InputError: a task does not fit the dataset: frames that are not connected, points that no camera sees ...
    """
    bars = calibration.error_bars
    return [] if bars is None else [task_error(calibration.solution, task, bars.sources) for task in tasks]


def task_error(solution: Solution, task: RobotTask, sources: tuple[ErrorSource, ...]) -> TaskError:
    """Return the error of a task at an optimum, by the errors of its parameters.

    Raises:
        InputError: as `task_errors`.
    """
    placed = place_task(solution.dataset, task, solution.setup.gauge)
    found = TaskError(placed, task_jacobian(solution, placed), sources)
    if not found.jacobian.any():
        raise InputError(
            f"tasks.{task.name}: nothing that is calibrated or held lies between the frames, so that its error is 0 "
            "and a limit says nothing: expected a sensor or a frame that could be elsewhere"
        )
    return found
