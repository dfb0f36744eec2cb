"""Logs of containers in CloudWatch, during their run and afterwards."""

import io
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.addons.aws_batch import logs
from calibration.addons.aws_batch.logs import write_log
from calibration.addons.aws_batch.session import Aws, AwsLostError
from calibration.addons.aws_batch.wire import TaskJob
from calibration.base import ExitCode
from calibration.ci.execution.outcome import End
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.addons.aws_batch.client import SETTINGS, Did, Tasks, container, job, jobs, run_jobs, wait_for
from tests.addons.aws_batch.emulator.attempt import Attempt
from tests.addons.aws_batch.emulator.instant import ended
from tests.addons.aws_batch.fixtures import REGION
from tests.addons.aws_batch.fixtures import Aws as FakeAws

pytestmark = pytest.mark.usefixtures("quick")
GROUP = "/aws/batch/job"
NOW = round(time.time() * 1000)


@pytest.fixture
def aws(batch_emulator: FakeAws) -> Iterator[Aws]:
    aws = Aws(REGION)
    yield aws
    aws.close()


def write(batch_emulator: FakeAws, stream: str, *lines: str, later: int = 0) -> None:
    now = NOW + later
    batch_emulator.services.log(REGION, GROUP, stream, [(now + i, line) for i, line in enumerate(lines)])


def test_a_log_of_many_pages_is_complete(aws: Aws, batch_emulator: FakeAws, tmp_path: Path) -> None:
    lines = [f"line {i}" for i in range(25_000)]
    for start in range(0, len(lines), 5000):
        write(batch_emulator, "s", *lines[start : start + 5000], later=start)
    assert write_log(aws, GROUP, "s", tmp_path / "log", ()) == "line 24999"
    assert (tmp_path / "log").read_text().splitlines() == lines
    assert batch_emulator.services.calls["GetLogEvents"] > 2


def test_a_log_is_cut(aws: Aws, batch_emulator: FakeAws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "MOST_BYTES", 100)
    write(batch_emulator, "s", *["x" * 50] * 10)
    write_log(aws, GROUP, "s", tmp_path / "log", ())
    assert batch_emulator.services.calls["GetLogEvents"] == 1  # the rest is not requested


def test_no_such_log(aws: Aws, batch_emulator: FakeAws, tmp_path: Path) -> None:
    assert write_log(aws, GROUP, "nosuch", tmp_path / "log", ()) == ""
    assert (tmp_path / "log").read_text() == ""
    assert batch_emulator.services.calls["GetLogEvents"] == 3


def test_logs_are_shown_while_jobs_run(batch_emulator: FakeAws, tmp_path: Path) -> None:
    shown = io.StringIO()
    secret = "pl4nted-value"  # noqa: S105

    def work(task: TaskJob, attempt: Attempt) -> Did:
        for name in ("robot", "calibration-watch"):
            attempt.starts(name)
        write(batch_emulator, attempt.log_stream("robot")[1], "first", f"token {secret}")
        write(batch_emulator, attempt.log_stream("calibration-watch")[1], "nobody reads this")
        wait_for(lambda: "one/robot | first" in shown.getvalue())
        write(batch_emulator, attempt.log_stream("robot")[1], "::error::last", later=2)
        return Did()

    Tasks(batch_emulator, work)
    given = job("one", container(environment={"TOKEN": secret}, secrets=frozenset({"TOKEN"})))
    settings = replace(SETTINGS, secrets={"TOKEN": "arn:aws:secretsmanager:eu-west-1:123456789012:secret:t"})
    [outcome], _ = run_jobs(tmp_path, given, settings=settings, show=LogDisplay(Runner(stdout=shown)))
    lines = [line for line in shown.getvalue().splitlines() if line.startswith("one/robot | ")]
    assert lines == ["one/robot | first", "one/robot | token ***", "one/robot | ::error::last"]
    assert "nobody reads" not in shown.getvalue()
    assert outcome.containers[0].log is not None
    assert outcome.containers[0].log.read_text() == "first\ntoken ***\n::error::last\n"


def test_logs_that_may_not_be_read_cost_no_result(batch_emulator: FakeAws, tmp_path: Path) -> None:
    shown = io.StringIO()

    def work(task: TaskJob, attempt: Attempt) -> Did:
        attempt.starts("robot")
        wait_for(lambda: "cannot be read" in shown.getvalue())
        return Did({"dataset/a": b"a"})

    Tasks(batch_emulator, work)
    batch_emulator.services.faults.refuse("GetLogEvents", 400, "AccessDeniedException", "no", times=99)
    [outcome], _ = run_jobs(tmp_path, job(), show=LogDisplay(Runner(stdout=shown)))
    assert outcome.verdict == "pass"
    assert outcome.containers[0].log is not None
    assert "the log cannot be read: log /aws/batch/job" in outcome.containers[0].log.read_text()


def test_a_display_that_aws_leaves_alone_for_a_while(
    batch_emulator: FakeAws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.StringIO()
    real, away = logs._read_page, iter([AwsLostError("away")] * 2)

    def page(*arguments: object) -> object:
        for error in away:
            raise error
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(logs, "_read_page", page)

    def work(task: TaskJob, attempt: Attempt) -> Did:
        attempt.starts("robot")
        write(batch_emulator, attempt.log_stream("robot")[1], "first")
        wait_for(lambda: "one/robot | first" in shown.getvalue())
        return Did()

    Tasks(batch_emulator, work)
    [outcome], _ = run_jobs(tmp_path, job(), show=LogDisplay(Runner(stdout=shown)))
    assert outcome.verdict == "pass"


def test_of_many_jobs_only_logs_of_failed_ones_are_downloaded(batch_emulator: FakeAws, tmp_path: Path) -> None:
    def work(task: TaskJob, attempt: Attempt) -> Did:
        log = {"robot": [f"log of {task.job.name}"]}
        if task.job.name != "world/3":
            return Did(log=log)
        reason = "container 'robot' ended with exit code 1"
        ends = {"robot": (End.EXITED, 1)}
        return Did(log=log, reasons=(reason,), exit_code=ExitCode.FAIL, ends=ends, result=ended(attempt, {"robot": 1}))

    Tasks(batch_emulator, work)
    shown = io.StringIO()
    outcomes, _ = run_jobs(tmp_path, *jobs(17), show=LogDisplay(Runner(stdout=shown)))
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.log")] == ["world/3/logs/robot.log"]
    assert outcomes[3].reasons == ("container 'robot' ended with exit code 1: log of world/3",)
    assert "log of" not in shown.getvalue()
    assert [outcome.containers[0].log is None for outcome in outcomes] == [i != 3 for i in range(17)]


def test_a_closed_output_does_not_fail_the_run(batch_emulator: FakeAws, tmp_path: Path) -> None:
    gone = io.StringIO()
    gone.close()
    Tasks(batch_emulator)
    [outcome], _ = run_jobs(tmp_path, job(), show=LogDisplay(Runner(stdout=gone)))
    assert outcome.verdict == "pass"


def test_lines_of_our_own_command_nothing() -> None:
    shown = io.StringIO()
    LogDisplay(Runner(stdout=shown)).note("host\n\x1b[2J lost")
    assert shown.getvalue() == "host \\x1b[2J lost\n"
