"""Runs on the emulator, whose tasks end immediately."""

import hashlib
import io
import json
import threading
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch import following
from calibration.addons.aws_batch import run as run_module
from calibration.addons.aws_batch.backend import BatchBackend
from calibration.addons.aws_batch.results import Downloader
from calibration.addons.aws_batch.session import Aws as Client
from calibration.addons.aws_batch.session import AwsLostError, Backoff
from calibration.addons.aws_batch.submitting import terminate
from calibration.addons.aws_batch.wire import PREPARE_CONTAINER, TaskJob
from calibration.base import ExitCode, InfrastructureError
from calibration.ci.execution.job import Limits, Mount
from calibration.ci.execution.outcome import End, JobOutcome
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.addons.aws_batch.client import (
    SETTINGS,
    Did,
    Tasks,
    container,
    job,
    jobs,
    run_jobs,
    running,
    unpacked,
    wait_for,
)
from tests.addons.aws_batch.emulator.attempt import Attempt
from tests.addons.aws_batch.emulator.faults import child
from tests.addons.aws_batch.emulator.instant import ended, failed_to_start, host_lost
from tests.addons.aws_batch.fixtures import BUCKET, Aws

pytestmark = pytest.mark.usefixtures("quick")


def test_jobs_of_one_shape_are_one_array_and_their_files_land_as_from_docker(
    batch_emulator: Aws, tmp_path: Path
) -> None:
    tasks = Tasks(batch_emulator)
    outcomes, backend = run_jobs(tmp_path, *jobs(5))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 5
    assert sorted(tasks.ran) == [(f"world/{i}", 1) for i in range(5)]
    assert batch_emulator.batch.calls["SubmitJob"] == 1
    for i, outcome in enumerate(outcomes):
        assert outcome.folder == tmp_path / "world" / str(i)
        assert (outcome.folder / "artifacts" / "dataset" / "name").read_text() == f"world/{i}"
        assert outcome.seconds == 12.5
        manifest = json.loads((outcome.folder / "manifest.json").read_text())
        assert (manifest["run"], manifest["job"], manifest["verdict"]) == (backend.run_name, f"world/{i}", "pass")
        [container] = outcome.containers
        assert (container.name, container.end, container.exit_code) == ("robot", End.EXITED, 0)
    assert running(batch_emulator) == []


def test_one_job_is_no_array(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator)
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.exit_code == ExitCode.PASS
    [(_, request)] = [call for call in batch_emulator.batch.requests if call[0] == "SubmitJob"]
    assert "arrayProperties" not in request


def test_inputs_go_once_and_the_definition_only_when_it_differs(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    folder = tmp_path / "in"
    (folder / "deep").mkdir(parents=True)
    (folder / "motion.json").write_text("{}")
    (folder / "deep" / "run.sh").write_text("true")
    (folder / "deep" / "run.sh").chmod(0o700)
    seen: list[dict[str, bytes]] = []

    def look(task: TaskJob, attempt: Attempt) -> Did:
        [given] = task.inputs
        data = batch_emulator.services.get(BUCKET, given.key)
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (given.sha256, given.size)
        seen.append(unpacked(data))
        return Did()

    tasks.do = look
    mounts = (Mount(folder, "/calibration/in"),)
    given = [job(f"{i}", container(command=(str(i),), mounts=mounts)) for i in range(3)]
    run_jobs(tmp_path / "out", *given)
    assert seen == [{"motion.json": b"{}", "deep/run.sh": b"true"}] * 3
    calls = batch_emulator.batch.calls
    assert (calls["RegisterJobDefinition"], len(batch_emulator.services.keys(BUCKET, "calibration/inputs/"))) == (1, 1)

    (folder / "motion.json").write_text("[]")  # a changed input needs no other definition
    run_jobs(tmp_path / "out", *given)
    assert (calls["RegisterJobDefinition"], len(batch_emulator.services.keys(BUCKET, "calibration/inputs/"))) == (1, 2)
    larger = [replace(each, containers=(replace(each.containers[0], limits=Limits(cpus=2)),)) for each in given]
    run_jobs(tmp_path / "out", *larger)
    assert calls["RegisterJobDefinition"] == 2


def test_a_failure_is_reported_with_the_last_line_of_the_log(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    secret = "pl4nted-value"  # noqa: S105
    reason = "container 'robot' ended with exit code 4"
    tasks.do = lambda task, attempt: Did(
        reasons=(reason,),
        exit_code=ExitCode.FAIL,
        ends={"robot": (End.EXITED, 4)},
        log={"robot": ["starting", f"token {secret}", "no board\x1b[2J found"]},
        result=ended(attempt, {"robot": 4}),
    )
    settings = replace(SETTINGS, secrets={"TOKEN": "arn:aws:secretsmanager:eu-west-1:123456789012:secret:t"})
    with_secret = job("one", container(environment={"TOKEN": secret}, secrets=frozenset({"TOKEN"})))
    [outcome], _ = run_jobs(tmp_path, with_secret, settings=settings)
    assert (outcome.exit_code, outcome.reasons) == (ExitCode.FAIL, (f"{reason}: no board found",))
    assert outcome.containers[0].log is not None
    assert outcome.containers[0].log.read_text() == "starting\ntoken ***\nno board\x1b[2J found\n"
    everything = b"".join(batch_emulator.services.get(BUCKET, key) for key in batch_emulator.services.keys(BUCKET))
    assert secret.encode() not in everything
    assert secret not in json.dumps(batch_emulator.batch.requests)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (
            Did(
                ends={"robot": (End.LOST, None)},
                reasons=("container 'robot' ended without an exit code: it was killed",),
                exit_code=ExitCode.FAIL,
            ),
            1,
        ),
        (Did(), 1),
    ],
    ids=["its heartbeat stopped", "a child of it, which it survived"],
)
def test_batch_knows_that_memory_ran_out(batch_emulator: Aws, tmp_path: Path, said: Did, expected: int) -> None:
    tasks = Tasks(batch_emulator)
    out = "OutOfMemoryError: Container killed due to memory usage"
    tasks.do = lambda task, attempt: replace(said, result=ended(attempt, {"robot": 137}, {"robot": out}))
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.exit_code == expected
    assert outcome.reasons == ("container 'robot' ran out of memory: its limit is 2 GiB (memory)",)
    assert outcome.containers[0].end == End.OUT_OF_MEMORY


def test_a_lost_host_is_tried_again_and_the_newest_complete_result_counts(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    batch_emulator.faults.lose_host(child(1), attempts=(1, 2))
    log = io.StringIO()
    outcomes, _ = run_jobs(tmp_path, *jobs(3), show=LogDisplay(Runner(stdout=log)))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 3
    assert tasks.ran.count(("world/1", 3)) == 1
    assert "job 'world/1': attempt 1 of 3 lost its host: Host EC2 (instance i-" in log.getvalue()
    assert "3 done, 0 failed; billed: " in log.getvalue()


def test_a_host_that_is_lost_each_time_is_named_and_the_others_are_not_lost(
    batch_emulator: Aws, tmp_path: Path
) -> None:
    Tasks(batch_emulator)
    batch_emulator.faults.lose_host(child(1), attempts=(1, 2, 3))
    outcomes, _ = run_jobs(tmp_path, *jobs(3))
    assert [outcome.exit_code for outcome in outcomes] == [0, 3, 0]
    assert outcomes[1].reasons[0].startswith("its host was lost 3 times, in 3 attempts: Host EC2 (instance i-")
    assert outcomes[1].containers[0].end == End.LOST


def test_a_result_that_was_complete_before_its_host_was_lost_counts(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    lost = lambda task, attempt: Did({"dataset/a": b"a"}, result=host_lost())  # noqa: E731
    tasks.do = lost
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.verdict == "pass"
    assert (outcome.folder / "artifacts/dataset/a").read_bytes() == b"a"


@pytest.mark.parametrize(
    ("reason", "code", "message"),
    [
        (
            "CannotPullContainerError: pull image manifest: team/robot:1: not found",
            2,
            "container 'robot': the image team/robot:1 cannot be pulled: ",
        ),
        ("CannotPullContainerError: i/o timeout", 3, "container 'robot': the image team/robot:1 cannot be pulled: "),
    ],
)
def test_an_image_that_cannot_be_pulled(
    batch_emulator: Aws, tmp_path: Path, reason: str, code: int, message: str
) -> None:
    tasks = Tasks(batch_emulator)
    tasks.do = lambda task, attempt: Did(
        document=lambda _: None, result=ended(attempt, {"robot": 1}, {"robot": reason})
    )
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.exit_code == code
    assert outcome.reasons == (f"{message}{reason}",)


def test_a_task_that_never_started(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    reason = "ResourceInitializationError: unable to pull secrets or registry auth"
    tasks.do = lambda task, attempt: Did(document=lambda _: None, result=failed_to_start(reason))
    [outcome], _ = run_jobs(tmp_path, job())
    assert (outcome.exit_code, outcome.reasons) == (
        ExitCode.INFRASTRUCTURE,
        (f"its task could not be set up: check roles, secrets and network: {reason}",),
    )


def test_failed_downloads_of_inputs_are_reported_from_our_log(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    tasks.do = lambda task, attempt: Did(
        document=lambda _: None,
        log={PREPARE_CONTAINER: ["error: bucket is gone"]},
        result=ended(attempt, {PREPARE_CONTAINER: 3}),
    )
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.exit_code == ExitCode.INFRASTRUCTURE
    assert outcome.reasons == (
        f"its inputs could not be downloaded: {PREPARE_CONTAINER} ended with exit code 3: error: bucket is gone",
    )


Document = dict[str, Any]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda document: None, "AWS Batch reports success, but its task has left no outcome in S3"),
        (lambda document: {**document, "job": "another"}, "job: found 'another', expected 'one'"),
        (lambda document: {**document, "exit_code": 0, "reasons": ["x"]}, "exit_code: found 0"),
        (
            lambda document: {**document, "artifacts": [{**document["artifacts"][0], "path": "../../x"}]},
            "leaves its folder",
        ),
        (
            lambda document: {**document, "artifacts": [{**document["artifacts"][0], "size": 3}]},
            "differs from the outcome of the task",
        ),
        (
            lambda document: {**document, "artifacts": [{**document["artifacts"][0], "sha256": "0" * 64}]},
            "differs from the outcome of the task",
        ),
        (
            lambda document: {**document, "artifacts": [{**document["artifacts"][0], "path": "dataset/other"}]},
            "differs from the outcome of the task",
        ),
    ],
    ids=["none", "another job's", "contradiction", "outside", "size", "content", "missing"],
)
def test_an_outcome_is_not_believed(
    batch_emulator: Aws, tmp_path: Path, change: Callable[[Document], Document | None], message: str
) -> None:
    tasks = Tasks(batch_emulator)
    tasks.do = lambda task, attempt: Did({"dataset/a": b"abcd"}, document=change)
    outcomes, _ = run_jobs(tmp_path, job())
    [outcome] = outcomes
    assert outcome.exit_code == ExitCode.INFRASTRUCTURE
    assert message in outcome.reasons[0]
    assert outcome.artifacts == ()
    assert [path for path in (tmp_path / "one" / "artifacts").rglob("*") if path.is_file()] == []


def test_results_of_an_earlier_run_are_removed(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator)
    old = tmp_path / "one" / "artifacts" / "old.txt"
    old.parent.mkdir(parents=True)
    old.write_text("old")
    [outcome], _ = run_jobs(tmp_path, job())
    assert not old.exists()
    assert outcome.verdict == "pass"


def test_resume_runs_only_missing_and_changed_jobs(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    good = tasks.do
    tasks.do = lambda task, attempt: None if task.job.name in ("world/1", "world/4") else good(task, attempt)
    first, _ = run_jobs(tmp_path, *jobs(6), run="nightly.7")
    assert [outcome.exit_code for outcome in first] == [0, 3, 0, 0, 3, 0]
    tasks.do, tasks.ran = good, []
    changed = jobs(6)
    changed[2] = job("world/2", container(command=("collect", "--seed", "20")))
    again, _ = run_jobs(tmp_path, *changed, run="nightly.7", resume=True)
    assert sorted(name for name, _ in tasks.ran) == ["world/1", "world/2", "world/4"]
    assert [outcome.verdict for outcome in again] == ["pass"] * 6
    assert (again[0].folder / "artifacts/dataset/name").read_text() == "world/0"
    tasks.ran = []
    run_jobs(tmp_path, *changed, run="nightly.7", resume=True)
    assert tasks.ran == []
    run_jobs(tmp_path, *changed, run="nightly.7")  # without resume, all jobs run again
    assert len(tasks.ran) == 6


def test_resume_repeats_infrastructure_errors(batch_emulator: Aws, tmp_path: Path) -> None:
    """A verdict of the software is kept; other failures are run again."""
    tasks = Tasks(batch_emulator)
    good, codes = (
        tasks.do,
        {"world/0": ExitCode.INFRASTRUCTURE, "world/1": ExitCode.FAIL, "world/2": ExitCode.BAD_INPUT},
    )
    ends = {"robot": (End.EXITED, 1)}
    tasks.do = lambda task, attempt: Did(reasons=("it failed",), exit_code=codes[task.job.name], ends=ends)
    run_jobs(tmp_path, *jobs(3), run="nightly", resume=False)
    tasks.do, tasks.ran = good, []
    again, _ = run_jobs(tmp_path, *jobs(3), run="nightly", resume=True)
    assert sorted(name for name, _ in tasks.ran) == ["world/0", "world/2"]
    assert [outcome.exit_code for outcome in again] == [0, 1, 0]


def test_resume_terminates_jobs_of_the_dead_client(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)

    def hang(task: TaskJob, attempt: Attempt) -> Did:
        attempt.stop.wait(240)
        return Did()

    good, tasks.do = tasks.do, hang
    with BatchBackend(SETTINGS, "mine") as other, BatchBackend(SETTINGS, "others") as stranger:
        first, second = other.run(jobs(2), tmp_path / "a"), stranger.run(jobs(2), tmp_path / "b")

        def ask(run: Generator[tuple[int, JobOutcome]]) -> None:
            with suppress(StopIteration):
                next(run)

        threads = [threading.Thread(target=ask, args=(run,), daemon=True) for run in (first, second)]
        for thread in threads:
            thread.start()
        wait_for(lambda: len(tasks.ran) == 4)
        tasks.do = good
        outcomes, _ = run_jobs(tmp_path / "c", *jobs(2), run="mine", resume=True)
        assert [outcome.verdict for outcome in outcomes] == ["pass"] * 2
        assert len(running(batch_emulator)) == 1
        threads[0].join(60)
        terminate(stranger.aws, running(batch_emulator), "test")
        threads[1].join(60)
    assert running(batch_emulator) == []


def test_a_run_that_is_resumed_judges_as_the_first_did(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    out = {"robot": "OutOfMemoryError: Container killed due to memory usage"}
    tasks.do = lambda task, attempt: Did(log={"robot": ["eating"]}, result=ended(attempt, {"robot": 0}, out))
    first, _ = run_jobs(tmp_path, *jobs(2), run="again")
    tasks.ran = []
    second, backend = run_jobs(tmp_path, *jobs(2), run="again", resume=True)
    assert tasks.ran == []
    assert [outcome.reasons for outcome in first] == [outcome.reasons for outcome in second]
    assert second[0].reasons == ("container 'robot' ran out of memory: its limit is 2 GiB (memory): eating",)
    assert backend.usage.seconds == 0  # nothing is billed twice
    batch_emulator.batch.jobs.jobs.clear()  # as after a week
    third, _ = run_jobs(tmp_path, *jobs(2), run="again", resume=True)
    assert [outcome.verdict for outcome in third] == ["pass"] * 2


def test_broken_results_of_an_earlier_run(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)
    run_jobs(tmp_path, *jobs(2), run="again")
    services = batch_emulator.services
    [listed] = [key for key in services.keys(BUCKET) if key.endswith("/jobs/00000.json") or "/00000.json" in key]
    good = services.get(BUCKET, listed)
    for content, count in ((b"{}", 2), (b"[1, 2]", 2), (good, 0)):
        services.put(BUCKET, listed, content)
        tasks.ran = []
        run_jobs(tmp_path, *jobs(2), run="again", resume=True)
        assert len(tasks.ran) == count
        for key in services.keys(BUCKET, "calibration/runs/again/"):
            if listed.split("/")[-2] not in key:
                services._s3().delete_object(BUCKET, key)
    services.put(BUCKET, listed, b"no JSON")
    with pytest.raises(InfrastructureError, match="this is no JSON"):
        run_jobs(tmp_path, *jobs(2), run="again", resume=True)


def test_a_result_that_vanishes(batch_emulator: Aws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Tasks(batch_emulator)
    run_jobs(tmp_path, job(), run="again")
    batch_emulator.batch.jobs.jobs.clear()
    monkeypatch.setattr(Downloader, "_read_outcome", lambda *_: None)
    [outcome], _ = run_jobs(tmp_path, job(), run="again", resume=True)
    assert (outcome.exit_code, outcome.reasons) == (ExitCode.INFRASTRUCTURE, ("its result is missing in S3",))


def test_the_result_of_an_older_attempt_is_found(batch_emulator: Aws, tmp_path: Path) -> None:
    tasks = Tasks(batch_emulator)

    def work(task: TaskJob, attempt: Attempt) -> Did:
        if attempt.number == 1:
            return Did({"dataset/a": b"first"}, result=host_lost())
        return Did(document=lambda _: None, result=host_lost())

    tasks.do = work
    [outcome], _ = run_jobs(tmp_path, job())
    assert outcome.verdict == "pass"
    assert (outcome.folder / "artifacts/dataset/a").read_bytes() == b"first"


def test_aws_may_be_away_for_a_while(batch_emulator: Aws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Client._client_of_service, "__defaults__", (1, None))  # without boto3's own retries
    Tasks(batch_emulator)
    faults, services = batch_emulator.faults, batch_emulator.services.faults
    faults.drop("DescribeJobs", times=2)
    faults.server_error("DescribeJobs", times=2, after=1)
    faults.throttle("SubmitJob")
    services.refuse("s3:GET", 503, "SlowDown", "Please reduce your request rate.", times=3, after=1)
    services.refuse("s3:PUT", 500, "InternalError", "We encountered an internal error.", times=2)
    outcomes, _ = run_jobs(tmp_path, *jobs(3))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 3
    assert batch_emulator.faults.had["DescribeJobs"] == 4
    assert services.had["s3:GET"] == 3


def test_aws_that_stays_away(batch_emulator: Aws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Client._client_of_service, "__defaults__", (1, None))
    monkeypatch.setattr(Backoff.__init__, "__defaults__", (0.2,))
    Tasks(batch_emulator)
    batch_emulator.services.faults.refuse("s3:GET", 503, "SlowDown", "slower", times=999)
    with pytest.raises(AwsLostError, match="bucket 'robots-results': AWS: s3:GetObject: SlowDown: too many requests"):
        run_jobs(tmp_path, *jobs(3))
    assert running(batch_emulator) == []


def test_a_folder_that_cannot_be_written_is_no_verdict(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator)
    (tmp_path / "one").write_text("in the way")
    with pytest.raises(InfrastructureError, match="one: cannot be written"):
        run_jobs(tmp_path, job())
    assert running(batch_emulator) == []


def test_more_results_than_fit_on_their_way(
    batch_emulator: Aws, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_module, "_MAX_DOWNLOADS", 2)
    monkeypatch.setattr(following, "JOBS_PER_CALL", 3)
    Tasks(batch_emulator)
    outcomes, _ = run_jobs(tmp_path, *jobs(12))
    assert [outcome.verdict for outcome in outcomes] == ["pass"] * 12


def test_an_answer_without_an_id(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator)
    with BatchBackend(SETTINGS) as backend:
        outcomes = backend.run(jobs(2), tmp_path)
        backend.aws.submitting.submit_job = lambda **_: {}
        with pytest.raises(InfrastructureError, match="answers without the id of the job"):
            next(outcomes)
