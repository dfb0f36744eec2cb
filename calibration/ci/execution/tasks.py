"""Tasks, and the loop that runs them: functions in processes, jobs in containers.

A task is named work: a function, or a job of containers whose files are judged in this process. The loop reuses
finished results, runs the remaining tasks on the backends, reports the progress, and stops everything when it is
interrupted or a result demands it. A `calibration.ci.execution.workspace.Workspace` preserves finished results.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from calibration.ci.execution.backends import Backend, ExecutionTarget
from calibration.ci.execution.embedded import Embedded
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import JobOutcome

Result = TypeVar("Result")
Other = TypeVar("Other")


@dataclass(frozen=True, eq=False)
class Task(Generic[Result]):
    """Named work: a function or a job of containers, and the function that judges its outcome."""

    name: str
    """Unique among the tasks of a run."""
    work: Callable[[], Any] | Job
    """A function, which a worker process inherits with the data that it references; or a job of containers."""
    judge: Callable[[Any], Result]
    """Converts the function's picklable return value, or the job's outcome, to the result; runs in this process.
    A failure of a single task is part of its result."""

    @classmethod
    def call(cls, name: str, function: Callable[[], Result]) -> Self:
        """Create a task from a function."""
        return cls(name, function, _as_it_is)

    @classmethod
    def containers(cls, name: str, job: Job, judge: Callable[[JobOutcome], Result]) -> Self:
        """Create a task from a job of containers."""
        return cls(name, job, judge)

    def then(self, change: Callable[[Result], Other]) -> "Task[Other]":
        """Return the task with a function applied to its result, in the process that creates the result."""
        work, judge = self.work, self.judge
        if isinstance(work, Job):
            return Task(self.name, work, lambda outcome: change(judge(outcome)))
        function = work
        return Task(self.name, lambda: change(judge(function())), _as_it_is)


def run_tasks(
    tasks: Sequence[Task[Result]],
    folder: Path = Path(),
    workers: int | None = None,
    target: ExecutionTarget | None = None,
    find: Callable[[str], Result | None] = lambda _: None,
    done: Callable[[int, int, Result], None] = lambda *_: None,
    stops: Callable[[str, Result], bool] = lambda *_: False,
) -> dict[str, Result]:
    """Run tasks: functions first, in order, then jobs.

    An exception in a callback, or a signal, stops and removes everything that was started.

    Args:
        tasks: tasks to run.
        folder: folder that contains the jobs' folders.
        workers: number of concurrent processes, or jobs; None for the capacity of the machine.
        target: execution target of jobs; by default this machine's engine.
        find: returns the finished result of a task of an earlier run, by name.
        done: called after each task with the number of finished tasks, the total, and the result; starts with
            the results of earlier runs.
        stops: returns whether a task's result stops the others, by the task's name.

    Returns:
        Results by task name, in the order of the tasks, without stopped tasks.

    Raises:
        InputError: a job is invalid, or an image is missing; nothing has been run.
        InfrastructureError: a process died, or the execution target cannot be reached.
        CalibrationError: error of a function.
    """
    found = {task.name: kept for task in tasks if (kept := find(task.name)) is not None}
    for count, kept in enumerate(found.values()):
        done(count + 1, len(tasks), kept)
    missing = [task for task in tasks if task.name not in found]
    jobs = [task for task in missing if isinstance(task.work, Job)]
    functions = [task for task in missing if not isinstance(task.work, Job)]
    with ExitStack() as stack:
        backends: list[tuple[Backend[Any, Any], list[Task[Result]]]] = [(Embedded(), functions)]
        if jobs:  # connect before long work, because there may be no engine
            backends.append((stack.enter_context((target or ExecutionTarget()).open()), jobs))
        running = [
            (stack.enter_context(closing(backend.run([task.work for task in some], folder, workers))), some)
            for backend, some in backends
        ]
        for outcomes, some in running:
            for index, outcome in outcomes:
                task = some[index]
                found[task.name] = task.judge(outcome)
                done(len(found), len(tasks), found[task.name])
                if stops(task.name, found[task.name]):
                    return _in_order(tasks, found)
    return _in_order(tasks, found)


def _in_order(tasks: Sequence[Task[Result]], found: dict[str, Result]) -> dict[str, Result]:
    return {task.name: found[task.name] for task in tasks if task.name in found}


def _as_it_is(result: Result) -> Result:
    return result
