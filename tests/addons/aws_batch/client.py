"""Jobs for tests of the client, and tasks that behave as ours in the cloud, without containers."""

import hashlib
import io
import json
import tarfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calibration.addons.aws_batch.backend import BatchBackend
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import (
    FIRST_VARIABLE,
    JOBS_PER_FILE,
    LOCATION_VARIABLE,
    OUTCOME_FILE,
    PREPARE_CONTAINER,
    Location,
    TaskJob,
    TaskOutcome,
    outcome_document,
    read_job,
)
from calibration.base import ExitCode
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End, JobOutcome
from tests.addons.aws_batch.emulator.attempt import Attempt, Ended
from tests.addons.aws_batch.emulator.instant import ended
from tests.addons.aws_batch.fixtures import BUCKET, QUEUE, REGION, Aws

SETTINGS = BatchSettings(
    region=REGION,
    queue=QUEUE,
    bucket=BUCKET,
    tools_image="team/tools:1",
    job_role="arn:aws:iam::123456789012:role/job",
    execution_role="arn:aws:iam::123456789012:role/execution",
)


def container(name: str = "robot", **settings: Any) -> Container:
    settings.setdefault("command", ("calibrate",))
    settings.setdefault("artifacts", (Artifact(f"{OUTPUT}/dataset"),))
    return Container(name, settings.pop("image", "team/robot:1"), **settings)


def job(name: str = "one", *containers: Container, **settings: Any) -> Job:
    return Job(name, containers or (container(),), seconds=settings.pop("seconds", 300.0), **settings)


def jobs(count: int) -> list[Job]:
    """Return jobs of one shape, each with its own command."""
    return [job(f"world/{i}", container(command=("collect", "--seed", str(i)))) for i in range(count)]


@dataclass
class Did:
    """Result of a task."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    exit_code: ExitCode = ExitCode.PASS
    ends: Mapping[str, tuple[End, int | None]] = field(default_factory=dict)
    """Ends of containers that did not exit with 0."""
    log: Mapping[str, list[str]] = field(default_factory=dict)
    document: Callable[[dict[str, Any]], Any] | None = None
    """Changes the outcome before it is written; None as its result suppresses the outcome."""
    result: Ended | None = None
    """End reported to Batch; by default all containers exited with 0."""


Do = Callable[[TaskJob, Attempt], Did | None]


class Tasks:
    """Tasks that run a function of the test on jobs from S3."""

    def __init__(self, aws: Aws, do: Do | None = None) -> None:
        self.aws = aws
        self.do: Do = do or (lambda task, attempt: Did({"dataset/name": task.job.name.encode()}))
        self.ran: list[tuple[str, int]] = []
        """Name and attempt of each job that ran."""
        aws.batch.runner.function = self

    def __call__(self, attempt: Attempt) -> Ended | None:
        variables = attempt.environment(PREPARE_CONTAINER)
        location = Location.parse(variables[LOCATION_VARIABLE])
        index = int(variables[FIRST_VARIABLE]) + (attempt.index or 0)
        key = location.jobs_key(index)
        task = read_job(self.aws.services.get(location.bucket, key), index % JOBS_PER_FILE, key)
        self.ran.append((task.job.name, attempt.number))
        did = self.do(task, attempt)
        if did is None or attempt.stop.is_set():
            return ended(attempt)
        for name, lines in did.log.items():
            attempt.starts(name)
            group, stream = attempt.log_stream(name)
            self.aws.services.log(REGION, group, stream, [(round(time.time() * 1000), line) for line in lines])
        for path, content in did.files.items():
            self.aws.services.put(BUCKET, location.result_key(index, attempt.number, f"files/{path}"), content)
        document: Any = json.loads(outcome_document(outcome_of(task, attempt.number, did)))
        if did.document is not None:
            document = did.document(document)
        if document is not None:
            data = json.dumps(document).encode()
            self.aws.services.put(BUCKET, location.result_key(index, attempt.number, OUTCOME_FILE), data)
        return did.result or ended(attempt)


def outcome_of(task: TaskJob, attempt: int, did: Did) -> TaskOutcome:
    first = task.job.containers[0].name
    return TaskOutcome(
        job=task.job.name,
        attempt=attempt,
        exit_code=did.exit_code,
        reasons=did.reasons,
        seconds=12.5,
        containers=tuple(
            ContainerOutcome(each.name, *did.ends.get(each.name, (End.EXITED, 0)), seconds=10.0)
            for each in task.job.containers
        ),
        artifacts=tuple(
            ArtifactFile(path, first, len(content), hashlib.sha256(content).hexdigest())
            for path, content in did.files.items()
        ),
    )


def run_jobs(
    folder: Path, *given: Job, settings: BatchSettings = SETTINGS, **more: Any
) -> tuple[list[JobOutcome], BatchBackend]:
    """Run jobs; return their outcomes in the order of the jobs."""
    with BatchBackend(settings, **more) as backend:
        outcomes = dict(backend.run(given, folder))
    assert sorted(outcomes) == list(range(len(given)))
    return [outcomes[index] for index in range(len(given))], backend


def running(aws: Aws) -> list[str]:
    """Return the ids of unfinished jobs in the queue."""
    with aws.batch.jobs.lock:
        return [each.id for each in aws.batch.jobs.jobs.values() if not each.ended]


def unpacked(data: bytes) -> dict[str, bytes]:
    """Return the files in a tar."""
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        members = [member for member in archive if member.isreg()]
        return {member.name: archive.extractfile(member).read() for member in members}  # type: ignore[union-attr]


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait until a condition is met."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it does not come"
        time.sleep(0.02)
