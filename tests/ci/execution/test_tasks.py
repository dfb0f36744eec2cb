"""Loop over tasks: functions and jobs, in order, until a result stops the others."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.execution.tasks import Task, run_tasks


@dataclass
class Engine:
    """A backend that records its calls."""

    log: list[str] = field(default_factory=list)
    broken: bool = False

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        if self.broken:
            raise InputError("no such image")
        self.log.append(f"checked {len(jobs)}, {folder}, {workers}")
        return self._outcomes(jobs, folder)

    def _outcomes(self, jobs: Sequence[Job], folder: Path) -> Generator[tuple[int, JobOutcome]]:
        try:
            for index, job in reversed(list(enumerate(jobs))):
                yield index, JobOutcome(job.name, folder / job.name, seconds=index)
        finally:
            self.log.append("ended")


@dataclass(frozen=True)
class There(ExecutionTarget):
    """An execution target with this backend."""

    engine: Engine = field(default_factory=Engine)

    @contextmanager
    def open(self) -> Generator[Engine]:
        self.engine.log.append("opened")
        yield self.engine
        self.engine.log.append("closed")


def call(name: str) -> Task[str]:
    return Task.call(name, lambda: f"called {name}")


def job(name: str) -> Task[str]:
    return Task.containers(name, Job(name, (Container("c", "i"),)), lambda outcome: f"ran {outcome.folder}")


def test_functions_first_then_jobs_and_the_results_in_the_order_of_the_tasks(tmp_path: Path) -> None:
    target, told = There(), list[tuple[int, int, str]]()
    found = run_tasks(
        [job("a"), call("b"), job("c"), call("d")], tmp_path, 1, target, done=lambda *step: told.append(step)
    )
    assert list(found.items()) == [
        ("a", f"ran {tmp_path}/a"),
        ("b", "called b"),
        ("c", f"ran {tmp_path}/c"),
        ("d", "called d"),
    ]
    assert told == [(n + 1, 4, found[name]) for n, name in enumerate("bdca")]
    assert target.engine.log == ["opened", f"checked 2, {tmp_path}, 1", "ended", "closed"]


def test_without_jobs_no_engine_is_looked_for() -> None:
    target = There()
    assert run_tasks([call("a")], target=target) == {"a": "called a"}
    assert target.engine.log == []
    assert run_tasks(list[Task[str]]()) == {}


def test_earlier_results_are_reported_first_and_not_run_again() -> None:
    target, told = There(), list[str]()
    kept = {"b": "kept b", "c": "kept c"}
    found = run_tasks(
        [call("a"), call("b"), job("c")], target=target, find=kept.get, done=lambda *step: told.append(step[2])
    )
    assert list(found) == ["a", "b", "c"]
    assert told == ["kept b", "kept c", "called a"]
    assert target.engine.log == []


@pytest.mark.parametrize("last", ["b", "d"])
def test_a_result_that_stops_the_others(last: str) -> None:
    target = There()
    found = run_tasks(
        [call("a"), call("b"), job("c"), job("d")], workers=1, target=target, stops=lambda name, _: name == last
    )
    assert list(found) == {"b": ["a", "b"], "d": ["a", "b", "d"]}[last]
    assert target.engine.log[-1] == "closed"
    assert "ended" in target.engine.log or last == "b"  # jobs that were not started need not end


@pytest.mark.parametrize("where", ["judge", "done", "stops"])
def test_an_error_anywhere_ends_everything(where: str) -> None:
    def refuse(*_: object) -> Any:
        raise InfrastructureError("planted")

    target, tasks = There(), [job("a").then(refuse) if where == "judge" else job("a"), job("b")]
    callbacks = {where: refuse} if where != "judge" else {}
    with pytest.raises(InfrastructureError, match="planted"):
        run_tasks(tasks, target=target, **callbacks)
    assert "ended" in target.engine.log


def test_jobs_that_make_no_sense_are_refused_before_any_function_is_called() -> None:
    called = []
    tasks = [Task.call("a", lambda: called.append("a")), Task.containers("b", Job("b", ()), lambda _: None)]
    with pytest.raises(InputError, match="no such image"):
        run_tasks(tasks, target=There(engine=Engine(broken=True)))
    assert called == []


@pytest.mark.parametrize("task", [call("a"), job("a")])
def test_more_can_be_done_with_a_result(task: Task[str]) -> None:
    assert run_tasks([task.then(str.split)], Path("x"), target=There())["a"][0] in ("called", "ran")
