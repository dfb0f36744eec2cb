"""What the client and tasks on AWS Batch share: S3 keys, variables, containers, folders, and JSON documents in S3.

Layout of ``s3://BUCKET/PREFIX/``::

    inputs/SHA256.tar                        content of a mount, by its digest; shared by runs
    runs/RUN/jobs/GROUP/NNNNN.json           jobs of a group, `JOBS_PER_FILE` in each file
    runs/RUN/jobs/GROUP/submitted.json       ids of the submissions in AWS Batch
    runs/RUN/results/GROUP/INDEX/ATTEMPT/    results of one attempt: files/PATH..., and, last, outcome.json

A group contains jobs of one shape: one array (or several, above 10 000). Job ``INDEX_VARIABLE`` of a group is child
``INDEX - FIRST`` of its array.

``NNNNN.json`` is a list of jobs. An entry has the properties that differ between jobs of one shape, without secrets:
neither names nor values of secret variables, which AWS Batch sets in the container's environment itself.
``outcome.json`` is a task's report on its job; it is untrusted, and the client verifies all that can be verified.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from calibration.base import ExitCode, InfrastructureError, InputError, documents, one_line, shorten
from calibration.base.records import Converted, Place, between, document_of, field, length, read, record
from calibration.ci.execution.extraction import RefusedError, path_parts
from calibration.ci.execution.job import Container, Job, Limits, Relaxations
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End

PREPARE_CONTAINER, WATCH_CONTAINER = "calibration-prepare", "calibration-watch"
"""Our containers in every task: the first to run, and the essential one."""
JOB_FOLDER = "/calibration/job"
"""Volume shared by all containers of a task, with scripts and signals."""
MOUNTS_FOLDER = "/calibration/mounts"
"""Mount point of the volumes of the job's mounts in the first container: ``MOUNTS_FOLDER/0``, ``/1``..."""
JOBS_PER_FILE = 100
ARRIVAL_SECONDS = 1200.0
"""Time limit for the containers of a task to start, including pulls of images; the time of the job starts later."""
UPLOAD_SECONDS = 600.0
"""Time for stopping containers and uploading results, after the time of the job and before the time limit of the
task."""
OUTCOME_FILE, FILES_FOLDER = "outcome.json", "files"
LOCATION_VARIABLE, FIRST_VARIABLE = "CALIBRATION_LOCATION", "CALIBRATION_FIRST"
"""Variables of our containers, set on submission: ``s3://BUCKET/PREFIX``, run and group in the form of
`Location.text`, and the index of the array's first child."""
REGION_VARIABLE = "AWS_REGION"
"""Region of the bucket, set on submission, because ECS sets it only on Fargate."""
INDEX_VARIABLE, ATTEMPT_VARIABLE = "AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ATTEMPT"
"""Variables that Batch sets: index of the child (only in arrays), and of the attempt, from 1."""


@dataclass(frozen=True)
class Location:
    """Location of a group of a run's jobs in S3."""

    bucket: str
    prefix: str
    run: str
    group: str

    @property
    def text(self) -> str:
        """Value of the variable `LOCATION_VARIABLE`."""
        return f"s3://{self.bucket}/{self.prefix}/{self.run}/{self.group}"

    @classmethod
    def parse(cls, text: str) -> "Location":
        """Parse the variable `LOCATION_VARIABLE`."""
        bucket, _, path = text.removeprefix("s3://").partition("/")
        prefix, run, group = path.rsplit("/", 2)
        return cls(bucket, prefix, run, group)

    def input_key(self, sha256: str) -> str:
        """Return the key of a mount's content."""
        return f"{self.prefix}/inputs/{sha256}.tar"

    def jobs_key(self, index: int) -> str:
        """Return the key of the file with a job."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/{index // JOBS_PER_FILE:05}.json"

    @property
    def submitted_key(self) -> str:
        """Key of the file with the ids of the group's submissions."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/submitted.json"

    def attempts_key(self, index: int) -> str:
        """Return the prefix of the attempts at a job."""
        return f"{self.prefix}/runs/{self.run}/results/{self.group}/{index}/"

    def result_key(self, index: int, attempt: int, name: str = "") -> str:
        """Return the key of a file of an attempt, or their common prefix without a name."""
        return f"{self.attempts_key(index)}{attempt}/{name}"


MAX_JOBS_BYTES = 64 * 1024**2
"""Size limit of a file of jobs."""
_MAX_ENTRY_BYTES = 8192
"""Upper bound of the size of an entry in an outcome."""
_MAX_REASONS = 1000
_MAX_LINE_LENGTH = 4096

_Text = Annotated[str, length(most=_MAX_LINE_LENGTH)]
_Line = Annotated[str, Converted(_Text, lambda text, _: one_line(text))]
_Count = Annotated[int, between(0, 2**63 - 1)]


@record(case="snake", nulls=True)
class Input:
    """Initial content of a volume of a job."""

    volume: Annotated[int, between(0, 1000)] = field("Index in `mount_targets`.")
    key: _Text = field("Key of the tar in the bucket.")
    sha256: Annotated[str, length(most=64)] = field("Digest of the tar.")
    size: _Count = field("Size of the tar, in bytes.")
    writable: bool = field("Whether a container writes to it.", default=False)


@record
class TaskJob:
    """A job as its task reads it: the containers have no image, user, mounts or secrets."""

    job: Job = field(flat=True)
    inputs: tuple[Input, ...] = field("Initial content of the job's volumes.", default=())


def mount_targets(job: Job) -> tuple[str, ...]:
    """Return the mount targets of a job without duplicates; the index is the number of the volume."""
    return tuple(sorted({mount.target.rstrip("/") for container in job.containers for mount in container.mounts}))


def job_entry(job: Job, inputs: Iterable[Input], memory: int | None = None) -> dict[str, Any]:
    """Return the entry of a job: what its task needs, in the form of an entry of calibration.yml.

    Args:
        job: the job.
        inputs: content of its volumes.
        memory: default memory of a container, bytes.
    """
    needed = tuple(_needed_by_task(container, memory) for container in job.containers)
    by_name = {container.name: document_of(container, defaults=False) for container in needed}
    return {
        **document_of(TaskJob(replace(job, containers=()), tuple(inputs)), defaults=False),
        "containers": by_name,
    }


def _needed_by_task(container: Container, memory: int | None) -> Container:
    """Return a container without what AWS Batch sets: image, user, mounts, and the values and names of secrets."""
    return replace(
        container,
        image="",
        user=None,
        mounts=(),
        secrets=frozenset(),
        environment={k: v for k, v in container.environment.items() if k not in container.secrets},
        limits=Limits(memory=container.limits.memory or memory, seconds=container.limits.seconds),
        relaxations=Relaxations(),
    )


def jobs_document(entries: Sequence[dict[str, Any]]) -> bytes:
    """Return the file for a list of jobs, reproducible byte for byte."""
    return json.dumps(entries, separators=(",", ":"), allow_nan=False).encode()


def read_job(data: bytes, index: int, where: str) -> TaskJob:
    """Read one job of a file.

    Args:
        data: content of the file.
        index: index of the job in it.
        where: name of the file, for messages.

    Raises:
        InfrastructureError: the file is not in the form of `jobs_document`, or has no such job.
    """
    document = parse_json(data, MAX_JOBS_BYTES, where)
    if not isinstance(document, list) or not 0 <= index < len(document):
        raise InfrastructureError(f"{where}: there is no job {index} in it")
    try:
        return read(TaskJob, document[index], f"{where}: job {index}")
    except InputError as error:
        raise InfrastructureError(str(error)) from None


def parse_json(data: bytes, most: int, where: str) -> object:
    """Parse a document of at most ``most`` bytes.

    Raises:
        InfrastructureError: it is larger, or not valid JSON.
    """
    if len(data) > most:
        raise InfrastructureError(f"{where}: found {len(data)} bytes, at most {most} were expected")
    try:
        return documents.parse_json(data)
    except (ValueError, RecursionError) as error:
        raise InfrastructureError(f"{where}: this is no JSON: {shorten(str(error), 200)}") from None


@record(case="snake", nulls=True)
class TaskOutcome:
    """Outcome of one attempt at a job."""

    job: _Text = field("Name of the job.")
    attempt: _Count = field("Number of the attempt, from 1.")
    exit_code: Annotated[
        ExitCode, Converted(Annotated[int, between(0, max(ExitCode))], lambda code, _: ExitCode(code))
    ] = field("Exit code of the job, 0 if it passed.")
    reasons: Annotated[tuple[_Line, ...], length(most=_MAX_REASONS)] = field("Reasons of the failure.", default=())
    seconds: Annotated[float, between(0, 1e9)] = field("Duration.", default=0.0)
    containers: tuple[ContainerOutcome, ...] = field(
        "Outcomes of the containers, without logs and images, which the task does not know.", default=()
    )
    artifacts: tuple[ArtifactFile, ...] = field("Uploaded files.", default=())
    left_out: tuple[_Line, ...] = field("Notes on artifacts that were not copied.", default=())
    schema: Literal[1] = field("Version of the form.", default=1)


def max_outcome_bytes(job: Job) -> int:
    """Return the size limit of a job's outcome, to bound the download."""
    return _MAX_ENTRY_BYTES * (_MAX_REASONS + len(job.containers) + job.artifact_files)


def outcome_document(outcome: TaskOutcome) -> bytes:
    """Return the file of an outcome."""
    short = replace(
        outcome,
        reasons=tuple(shorten(reason, _MAX_LINE_LENGTH) for reason in outcome.reasons[:_MAX_REASONS]),
        seconds=round(outcome.seconds, 3),
        containers=tuple(replace(each, seconds=round(each.seconds, 3)) for each in outcome.containers),
        left_out=tuple(shorten(note, _MAX_LINE_LENGTH) for note in outcome.left_out),
    )
    return json.dumps(document_of(short), indent=1, allow_nan=False).encode()


def read_outcome(data: bytes, job: Job, attempt: int, where: str) -> TaskOutcome:
    """Read the outcome of an attempt at a job.

    Args:
        data: content of the file.
        job: expected job, whose limits apply to the artifacts.
        attempt: expected attempt.
        where: name of the file, for messages.

    Raises:
        InfrastructureError: the document is invalid, or inconsistent with the job or in itself.
    """
    place = Place(where, error=InfrastructureError)
    outcome = read(TaskOutcome, parse_json(data, max_outcome_bytes(job), where), where, error=InfrastructureError)
    for key, found, expected in (("job", outcome.job, job.name), ("attempt", outcome.attempt, attempt)):
        if found != expected:
            raise place.below(key).unexpected(found, repr(expected))
    for key, count in (("artifacts", len(outcome.artifacts)), ("left_out", len(outcome.left_out))):
        if count > job.artifact_files:
            raise place.below(key).fault(f"found {count}, expected at most {job.artifact_files}")
    if (outcome.exit_code == ExitCode.PASS) != (not outcome.reasons):
        raise place.below("exit_code").unexpected(int(outcome.exit_code), "0 without reasons, another with some")
    _check_containers(outcome, job, where)
    _check_artifacts(outcome, job, where)
    return outcome


def _check_containers(outcome: TaskOutcome, job: Job, where: str) -> None:
    """Check that the containers are the job's, and that a pass has a successful essential one and no failed one."""
    its = {container.name: container for container in outcome.containers}
    found, expected = [c.name for c in outcome.containers], [c.name for c in job.containers]
    if sorted(found) != sorted(expected):
        raise InfrastructureError(
            f"{where}: containers: found {shorten(str(found))}, expected {shorten(str(expected))}"
        )
    if outcome.exit_code != ExitCode.PASS:
        return
    ended = [c for c in job.containers if c.essential and its[c.name].end != End.STOPPED]
    for container in ended:
        end, code = its[container.name].end, its[container.name].exit_code
        if end != End.EXITED or code not in container.success:
            raise InfrastructureError(
                f"{where}: the job is reported as passed, but container '{container.name}' {end} with exit code {code}"
            )
    if not ended:
        raise InfrastructureError(f"{where}: the job is reported as passed, but no essential container ended")


def _check_artifacts(outcome: TaskOutcome, job: Job, where: str) -> None:
    if (size := sum(file.size for file in outcome.artifacts)) > job.artifact_bytes:
        raise InfrastructureError(f"{where}: artifacts: found {size} bytes, at most {job.artifact_bytes} were expected")
    names = {container.name for container in job.containers}
    paths: set[str] = set()
    for file in outcome.artifacts:
        try:
            parts = path_parts(file.path)
        except RefusedError as error:
            raise InfrastructureError(f"{where}: artifacts: {error}") from None
        if "/".join(parts) != file.path:
            raise InfrastructureError(
                f"{where}: artifacts: path: found {shorten(repr(file.path))}, expected a plain path"
            )
        if file.container not in names:
            raise InfrastructureError(f"{where}: artifacts: there is no container '{shorten(file.container)}'")
        if file.path in paths:
            raise InfrastructureError(f"{where}: artifacts: '{file.path}' occurs twice")
        paths.add(file.path)
    for file in outcome.artifacts:
        above = file.path.split("/")[:-1]
        for count in range(1, len(above) + 1):
            if (folder := "/".join(above[:count])) in paths:
                raise InfrastructureError(f"{where}: artifacts: '{folder}' is a folder and a file")
