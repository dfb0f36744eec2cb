"""Tasks, and the one loop that runs them: functions of ours in processes, jobs in containers.

A task is work with a name; its work is a function, or a job of containers whose files are judged here. The loop takes
what is done already, runs the rest on the backends, tells how far it is, and stops everything when it is interrupted or
a result says so. What is finished stays where a `calibration.execution.workspace.Workspace` keeps it.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from calibration.execution.backends import Backend, Place
from calibration.execution.embedded import Embedded
from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome

Result = TypeVar("Result")
Other = TypeVar("Other")


@dataclass(frozen=True, eq=False)
class Task(Generic[Result]):
    """One unit of work."""

    name: str
    """Unique among the tasks of a run."""
    work: Callable[[], Any] | Job
    """A function, which a worker process inherits with the data that it holds; or a job of containers."""
    judge: Callable[[Any], Result]
    """Makes the result of what the function returned, which must pickle, or of what came of the job; in this process.
    What went wrong in one task alone is part of its result."""

    @classmethod
    def call(cls, name: str, function: Callable[[], Result]) -> Self:
        """A function of ours."""
        return cls(name, function, _as_it_is)

    @classmethod
    def containers(cls, name: str, job: Job, judge: Callable[[JobOutcome], Result]) -> Self:
        """A job of containers."""
        return cls(name, job, judge)

    def then(self, change: Callable[[Result], Other]) -> "Task[Other]":
        """The task with something more to be done with its result, where the result is made."""
        work, judge = self.work, self.judge
        if isinstance(work, Job):
            return Task(self.name, work, lambda outcome: change(judge(outcome)))
        function = work
        return Task(self.name, lambda: change(judge(function())), _as_it_is)


def run_tasks(
    tasks: Sequence[Task[Result]],
    folder: Path = Path(),
    workers: int | None = None,
    place: Place | None = None,
    find: Callable[[str], Result | None] = lambda _: None,
    done: Callable[[int, int, Result], None] = lambda *_: None,
    stops: Callable[[str, Result], bool] = lambda *_: False,
) -> dict[str, Result]:
    """Run tasks: functions first, in their order, then jobs.

    An exception in any of the callbacks, or a signal, stops and removes everything that was started.

    Args:
        tasks: what to run.
        folder: of the jobs' folders.
        workers: processes, or jobs, at once; None for as many as the machine holds.
        place: where jobs run; this machine's engine unless given.
        find: gives the result that an earlier run has kept of a task, by its name.
        done: called after each task with how many are done, how many there are, and the result; first with what
            was found.
        stops: whether a task's result stops the others, by the task's name.

    Returns:
        The results by the tasks' names, in the tasks' order; tasks that were stopped are missing.

    Raises:
        InputError: a job makes no sense, or an image is missing; nothing has been run then.
        InfrastructureError: a process died, or the place cannot be reached.
        CalibrationError: what a function raises.
    """
    found = {task.name: kept for task in tasks if (kept := find(task.name)) is not None}
    for count, kept in enumerate(found.values()):
        done(count + 1, len(tasks), kept)
    missing = [task for task in tasks if task.name not in found]
    jobs = [task for task in missing if isinstance(task.work, Job)]
    functions = [task for task in missing if not isinstance(task.work, Job)]
    with ExitStack() as stack:
        backends: list[tuple[Backend[Any, Any], list[Task[Result]]]] = [(Embedded(), functions)]
        if jobs:  # the engine is looked for before long work: it may not be there
            backends.append((stack.enter_context((place or Place()).open()), jobs))
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
