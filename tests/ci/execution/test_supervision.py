"""Loop over the containers of a job, with simulated containers."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode, InfrastructureError
from calibration.ci.execution.job import Artifact, Container, Job, Readiness
from calibration.ci.execution.outcome import Archive, End, NothingThereError, Opener
from calibration.ci.execution.supervision import Supervised, Supervisor, how_it_ended


class Played(Supervised):
    """Is ready at poll ``ready_at``, and ends at poll ``ends_at`` with a code."""

    def __init__(self, container: Container, ready_at: int = 0, ends_at: int = 99, code: int = 0) -> None:
        super().__init__(container)
        self.ready_at, self.ends_at, self.code, self.polls = ready_at, ends_at, code, 0

    def poll(self) -> None:
        self.polls += 1
        self.ready = self.ready or self.polls >= self.ready_at
        if self.polls >= self.ends_at:
            self.ended = time.monotonic()

    def not_ready_for(self) -> str:
        return "port 1"


class Play(Supervisor[Played]):
    """Records its calls."""

    def __init__(self, job: Job, **roles: dict[str, int]) -> None:
        super().__init__(job, str)
        self.containers = [Played(each, **roles.get(each.name, {})) for each in job.containers]
        self.told: list[str] = []

    def _start(self, container: Played) -> None:
        if container.code < 0:
            raise InfrastructureError("cannot be started")
        self.told.append(f"start {container.name}")
        container.started = time.monotonic()
        container.ready = container.container.readiness is None

    def _wait(self, seconds: float | None) -> None:
        assert seconds is None or seconds >= 0

    def _stop(self, running: Sequence[Played]) -> None:
        self.told += [f"stop {each.name}" for each in running]
        for each in running:
            each.ended, each.code = time.monotonic(), 143

    def _read_end(self, container: Played, ours: End | None) -> None:
        container.exit_code = container.code
        container.end, container.signal = how_it_ended(container.container, container.code, False, ours)

    def _opener(self, container: Played) -> Opener:
        @contextmanager
        def nothing(_: str) -> Iterator[Archive]:
            raise NothingThereError
            yield

        return nothing


def container(name: str, **settings: Any) -> Container:
    return Container(name, "image", command=("run",), **settings)


SERVER = container("server", essential=False, readiness=Readiness(port=1))
CLIENT = container("client", after=("server",))


def test_a_container_starts_when_those_before_it_are_ready_and_the_rest_is_stopped(tmp_path: Path) -> None:
    play = Play(Job("job", (SERVER, CLIENT)), server={"ready_at": 3}, client={"ends_at": 2})
    play.supervise(tmp_path / "artifacts")
    assert play.told == ["start server", "start client", "stop server"]
    assert play.containers[0].polls >= 3
    assert [each.outcome().end for each in play.containers] == [End.STOPPED, End.EXITED]
    assert (play.judge.reasons, play.judge.exit_code) == ([], ExitCode.PASS)
    assert (tmp_path / "artifacts").is_dir()


def test_nothing_more_is_started_when_one_that_others_wait_for_ends_too_early(tmp_path: Path) -> None:
    play = Play(Job("job", (SERVER, CLIENT)), server={"ready_at": 99, "ends_at": 2, "code": 3})
    play.supervise(tmp_path / "artifacts")
    assert play.told == ["start server"]
    assert "it was not ready yet (port 1)" in play.judge.reasons[0]
    assert play.containers[1].outcome().end == End.NOT_STARTED


def test_the_rest_is_stopped_when_one_cannot_be_started(tmp_path: Path) -> None:
    play = Play(Job("job", (container("a"), container("b"))), b={"code": -1})
    with pytest.raises(InfrastructureError, match="cannot be started"):
        play.supervise(tmp_path / "artifacts")
    assert play.told == ["start a", "stop a"]
    assert play.containers[0].outcome().end == End.LOST
    assert not (tmp_path / "artifacts").exists()


def test_an_artifact_that_is_not_there_fails_the_job_unless_there_is_a_better_reason(tmp_path: Path) -> None:
    leaves = container("a", artifacts=(Artifact("/calibration/output/result"),))
    for code, reason in ((0, "left no file for the artifact"), (1, "ended with exit code 1")):
        play = Play(Job("job", (leaves,)), a={"ends_at": 1, "code": code})
        play.supervise(tmp_path / str(code))
        [found] = play.judge.reasons
        assert reason in found


class Watched:
    """A watch that knows a reason from the start."""

    def __init__(self, reason: str) -> None:
        self.reason, self.is_closed = reason, False

    def close(self) -> None:
        self.is_closed = True


@pytest.mark.parametrize("reason", ["", "too fast"])
def test_a_watch_ends_the_job_with_its_reason_and_is_closed_before_the_rest_is_stopped(
    tmp_path: Path, reason: str
) -> None:
    play = Play(Job("job", (container("robot"),)), robot={"ends_at": 3})
    play.watch = watch = Watched(reason)
    play.supervise(tmp_path / "artifacts")
    assert play.told == ["start robot", *(["stop robot"] if reason else [])]
    assert (play.judge.reasons, play.judge.exit_code) == (([reason], ExitCode.FAIL) if reason else ([], ExitCode.PASS))
    assert watch.is_closed
    assert (tmp_path / "artifacts").is_dir()
