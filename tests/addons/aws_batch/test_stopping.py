"""However a run ends, its jobs are terminated; if that is uncertain, it is reported."""

import io
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.addons.aws_batch.backend import BatchBackend
from calibration.addons.aws_batch.wire import TaskJob
from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.addons.aws_batch.client import SETTINGS, Did, Tasks, job, jobs, run_jobs, running, wait_for
from tests.addons.aws_batch.emulator.attempt import Attempt
from tests.addons.aws_batch.emulator.faults import child, named
from tests.addons.aws_batch.fixtures import Aws

pytestmark = pytest.mark.usefixtures("quick")


def hang(task: TaskJob, attempt: Attempt) -> Did | None:
    """Run until terminated; the first job ends at once."""
    if task.job.name != "world/0":
        attempt.stop.wait(240)
        return None
    return Did({"dataset/name": b"0"})


class Clock:
    """Controllable clock of the client: no test depends on the duration of attempts and downloads."""

    SPEED = 1000

    def __init__(self) -> None:
        self._ahead = 0.0
        self._hurries_since: float | None = None

    def monotonic(self) -> float:
        now = time.monotonic()
        return now + self._ahead + (0.0 if self._hurries_since is None else self.SPEED * (now - self._hurries_since))

    def hurry(self) -> None:
        """Run fast from now on."""
        if self._hurries_since is None:
            self._hurries_since = time.monotonic()

    def hurry_after(self, outcome: tuple[int, JobOutcome]) -> tuple[int, JobOutcome]:
        """Run fast after this outcome."""
        self.hurry()
        return outcome

    def rest(self) -> None:
        """Run normally again."""
        now = self.monotonic()
        self._hurries_since = None
        self._ahead = now - time.monotonic()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("calibration.addons.aws_batch.run.time", clock)
    monkeypatch.setattr("calibration.addons.aws_batch.checks.time", clock)
    return clock


def test_closing_the_iterator_ends_all(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)
    with BatchBackend(SETTINGS) as backend:
        outcomes = backend.run([*jobs(3), job("other", seconds=7.0)], tmp_path)
        assert next(outcomes)[0] == 0
        assert running(batch_emulator)
        outcomes.close()
        batch_emulator.batch.wait()
        assert next(backend.run(jobs(1), tmp_path))[1].verdict == "pass"  # it remains usable


def test_an_error_of_who_reads_ends_all(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)

    def fail(outcome: object) -> None:
        raise InfrastructureError("the disk is full")

    with BatchBackend(SETTINGS) as backend, pytest.raises(InfrastructureError, match="the disk is full"):
        list(map(fail, backend.run(jobs(3), tmp_path)))
    batch_emulator.batch.wait()


def test_a_context_that_is_left_early_ends_all(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)
    with BatchBackend(SETTINGS) as backend:
        outcomes = backend.run(jobs(3), tmp_path)
        next(outcomes)
    batch_emulator.batch.wait()


PROGRAM = """
import sys
from pathlib import Path
from calibration.addons.aws_batch.backend import BatchBackend
from calibration.base.process import terminate_cleanly
from tests.addons.aws_batch.client import SETTINGS, jobs

with terminate_cleanly(), BatchBackend(SETTINGS, "killed") as backend:
    for index, outcome in backend.run(jobs(3), Path(sys.argv[1])):
        print(index, flush=True)
"""


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all(batch_emulator: Aws, tmp_path: Path, number: signal.Signals) -> None:
    Tasks(batch_emulator, hang)
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"0\n"
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
        assert process.returncode not in (0, None)
        assert (b"KeyboardInterrupt" if number == signal.SIGINT else b"Terminated") in said
        batch_emulator.batch.wait()
    finally:
        process.kill()


def test_a_submission_with_a_lost_answer_is_terminated(
    batch_emulator: Aws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from calibration.addons.aws_batch import session

    monkeypatch.setattr(session, "LONGEST_OUTAGE", 0.0)
    monkeypatch.setattr(session.Backoff.__init__, "__defaults__", (0.0,))
    Tasks(batch_emulator, hang)
    batch_emulator.faults.drop("SubmitJob", answered=True)
    with BatchBackend(SETTINGS) as backend, pytest.raises(InfrastructureError, match="Connection was closed"):
        list(backend.run(jobs(2), tmp_path))
    assert len(batch_emulator.batch.jobs.jobs) == 1
    batch_emulator.batch.wait()


@pytest.mark.parametrize("answered", [True, False])
def test_a_lost_answer_submits_nothing_twice(batch_emulator: Aws, tmp_path: Path, answered: bool) -> None:
    tasks = Tasks(batch_emulator)
    batch_emulator.faults.drop("SubmitJob", answered=answered)
    outcomes, _ = run_jobs(tmp_path, *jobs(3))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 3
    assert len(tasks.ran) == 3


def test_duplicate_submissions_are_terminated(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)
    # the list of jobs lags behind, so the submission is found too late
    batch_emulator.faults.drop("SubmitJob", answered=True)
    batch = batch_emulator.batch
    listed = batch._calls.find("ListJobs")
    assert listed is not None
    answers = [{"jobSummaryList": []}]
    find = batch._calls.find
    batch._calls.find = lambda name: (  # type: ignore[method-assign]
        (lambda request: answers.pop() if answers else listed(request)) if name == "ListJobs" else find(name)
    )
    with BatchBackend(SETTINGS) as backend:
        outcomes = backend.run(jobs(2), tmp_path)
        next(outcomes)
        assert len(running(batch_emulator)) == 1
        outcomes.close()
    batch.wait()


def test_expired_credentials_are_one_line_with_advice(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)
    with BatchBackend(SETTINGS, "night") as backend:
        outcomes = backend.run(jobs(3), tmp_path)
        next(outcomes)
        batch_emulator.faults.expire()
        with pytest.raises(InputError) as caught:
            list(outcomes)
    assert str(caught.value) == (
        "jobs: AWS: batch:DescribeJobs: ExpiredTokenException: the credentials are expired: get new ones; to end "
        "jobs that may still run in AWS Batch: calibration cleanup --cloud --run night"
    )


def test_failed_terminations_are_reported(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, hang)
    with BatchBackend(SETTINGS, "night") as backend:
        outcomes = backend.run(jobs(3), tmp_path)
        next(outcomes)
        batch_emulator.faults.deny("TerminateJob")
        with pytest.raises(
            InputError, match=r"batch:TerminateJob: AccessDeniedException: .* cleanup --cloud --run night"
        ):
            outcomes.close()


def test_jobs_beyond_the_deadline_are_given_up_and_others_kept(
    batch_emulator: Aws, tmp_path: Path, clock: Clock
) -> None:
    Tasks(batch_emulator, hang)
    log = io.StringIO()
    with BatchBackend(replace(SETTINGS, deadline=500), show=LogDisplay(Runner(stdout=log))) as backend:
        outcomes = dict(map(clock.hurry_after, backend.run(jobs(3), tmp_path)))
    assert [outcomes[index].exit_code for index in range(3)] == [0, 3, 3]
    assert outcomes[1].reasons == ("the run took longer than its 500 s (deadline)",)
    assert "2 jobs are given up: the run took longer" in log.getvalue()
    assert running(batch_emulator) == []


def test_jobs_that_get_no_host_are_given_up_with_likely_reasons(
    batch_emulator: Aws, tmp_path: Path, clock: Clock
) -> None:
    Tasks(batch_emulator)
    said = "MISCONFIGURATION:COMPUTE_ENVIRONMENT_MAX_RESOURCE - too large"
    batch_emulator.faults.stick(child(1), said)
    batch_emulator.faults.stick(child(2))
    with BatchBackend(replace(SETTINGS, stuck=400, spot=False)) as backend:
        outcomes = dict(map(clock.hurry_after, backend.run(jobs(3), tmp_path)))
    assert [outcomes[index].exit_code for index in range(3)] == [0, 3, 3]
    for index in (1, 2):
        [reason] = outcomes[index].reasons
        assert reason.startswith(
            "it got no host within 400 s in queue 'robots' (stuck); likely reasons: AWS Batch reports: "
        )
        assert said in reason
        assert "subnet needs NAT" in reason
    assert running(batch_emulator) == []


def test_jobs_that_wait_behind_others_are_not_stuck(batch_emulator: Aws, tmp_path: Path, clock: Clock) -> None:
    four = threading.Barrier(4)  # number of hosts

    def slowly(task: TaskJob, attempt: Attempt) -> Did:
        if int(task.job.name.removeprefix("world/")) < 4:
            four.wait(60)
            clock.hurry()
            time.sleep(0.8)
            four.wait(60)
            clock.rest()
        return Did()

    Tasks(batch_emulator, slowly)
    outcomes, _ = run_jobs(tmp_path, *jobs(6), settings=replace(SETTINGS, stuck=500))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 6


def test_termination_by_another_process_is_reported(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator, hang)
    caught: list[CalibrationError] = []

    def end() -> None:
        wait_for(lambda: len(tasks.ran) == 2)
        batch = batch_emulator.client("batch")
        batch.terminate_job(jobId=running(batch_emulator)[0], reason="too expensive")
        batch.close()

    thread = threading.Thread(target=end)
    thread.start()
    outcomes, _ = run_jobs(tmp_path, *jobs(2))
    thread.join()
    assert caught == []
    assert outcomes[1].exit_code == 3
    assert outcomes[1].reasons == ("it was terminated by another process: too expensive",)


def test_a_single_job_that_is_stuck(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator)
    batch_emulator.faults.stick(lambda job: named(job.name)(job))
    [outcome], _ = run_jobs(tmp_path, job(), settings=replace(SETTINGS, stuck=0.2))
    assert outcome.exit_code == 3
    assert "(stuck)" in outcome.reasons[0]
