"""JSON documents exchanged in S3 between the client and tasks; those of tasks are untrusted.

``jobs/GROUP/NNNNN.json``: a list of jobs. An entry has the properties that differ between jobs of one shape, without
secrets: neither names nor values of secret variables, which AWS Batch sets in the container's environment itself.

``outcome.json``: a task's report on its job, written last; the client verifies all that can be verified.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from calibration.base import json_file
from calibration.base.errors import ExitCode, InfrastructureError
from calibration.base.records import Constraint, Place, between, document_of, field, length, matching, read, record
from calibration.base.text import one_line, shorten
from calibration.ci.execution.extraction import RefusedError, path_parts
from calibration.ci.execution.job import Artifact, Container, Job, Limits, Readiness
from calibration.ci.execution.job_check import NAME
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End

MOST_BYTES = 64 * 1024**2
"""Size limit of a file of jobs."""
_BYTES_EACH = 8192
"""Upper bound of the size of an entry in an outcome."""
_MOST_REASONS = 1000
_LONGEST = 4096

_Text = Annotated[str, length(most=_LONGEST)]
_Texts = Annotated[tuple[Annotated[str, length(most=2**20)], ...], length(most=10_000)]
_Seconds = Annotated[float, between(0, 1e9)]
_Count = Annotated[int, between(0, 2**63 - 1)]
_Name = Annotated[str, matching(NAME.pattern, "the name of a container")]
"""Container name, which is also used in file names."""
_ExitCode = Annotated[int, between(0, 255)]
_Few = length(most=1000)


@record(case="snake", nulls=True)
class Input:
    """Initial content of a volume of a job."""

    volume: Annotated[int, between(0, 1000)] = field("Index in `mount_targets`.")
    key: _Text = field("Key of the tar in the bucket.")
    sha256: Annotated[str, length(most=64)] = field("Digest of the tar.")
    size: _Count = field("Size of the tar, in bytes.")
    writable: bool = field("Whether a container writes to it.", default=False)


@record(case="snake", nulls=True)
class _ReadinessEntry:
    port: Annotated[int, between(1, 65535)] | None = field()
    log: _Text | None = field()
    file: _Text | None = field()
    command: _Texts = field()
    seconds: _Seconds = field()


@record(case="snake", nulls=True)
class _ArtifactEntry:
    path: _Text = field()
    required: bool = field()


@record(case="snake", nulls=True)
class _ContainerEntry:
    name: _Name = field()
    command: _Texts = field()
    entrypoint: _Texts | None = field()
    environment: Mapping[str, str] = field()
    working_directory: _Text | None = field()
    after: _Texts = field()
    essential: bool = field()
    success: Annotated[tuple[_ExitCode, ...], _Few] = field()
    seconds: _Seconds | None = field()
    memory: _Count | None = field()
    readiness: _ReadinessEntry | None = field()
    artifacts: Annotated[tuple[_ArtifactEntry, ...], _Few] = field()


@record(case="snake", nulls=True)
class _JobEntry:
    job: _Text = field()
    seconds: _Seconds | None = field()
    artifact_bytes: _Count = field()
    artifact_files: _Count = field()
    containers: Annotated[tuple[_ContainerEntry, ...], _Few] = field()
    mounts: Annotated[tuple[Input, ...], _Few] = field()


@dataclass(frozen=True)
class TaskJob:
    """A job as the task reads it: its containers have no image, user, mounts or secrets."""

    job: Job
    inputs: tuple[Input, ...] = ()


def mount_targets(job: Job) -> tuple[str, ...]:
    """Return the mount targets of a job without duplicates; the index is the number of the volume."""
    return tuple(sorted({mount.target.rstrip("/") for container in job.containers for mount in container.mounts}))


def job_entry(job: Job, inputs: Iterable[Input], memory: int | None = None) -> dict[str, Any]:
    """Return the entry of a job.

    Args:
        job: the job.
        inputs: content of its volumes.
        memory: default memory of a container, bytes.
    """
    containers = tuple(_entry_of(container, memory) for container in job.containers)
    entry = _JobEntry(job.name, job.seconds, job.artifact_bytes, job.artifact_files, containers, tuple(inputs))
    return document_of(entry)


def jobs_document(entries: Sequence[dict[str, Any]]) -> bytes:
    """Return the file for a list of jobs, reproducible byte for byte."""
    return json.dumps(entries, separators=(",", ":"), sort_keys=True, allow_nan=False).encode()


def read_job(data: bytes, index: int, where: str) -> TaskJob:
    """Read one job of a file.

    Args:
        data: content of the file.
        index: index of the job in it.
        where: name of the file, for messages.

    Raises:
        InfrastructureError: the file is not in the form of `jobs_document`, or has no such job.
    """
    document = parse_json(data, MOST_BYTES, where)
    if not isinstance(document, list) or not 0 <= index < len(document):
        raise InfrastructureError(f"{where}: there is no job {index} in it")
    entry = read(_JobEntry, document[index], f"{where}: job {index}", error=InfrastructureError)
    job = Job(
        name=entry.job,
        seconds=entry.seconds,
        artifact_bytes=entry.artifact_bytes,
        artifact_files=entry.artifact_files,
        containers=tuple(map(_container_of, entry.containers)),
    )
    return TaskJob(job, entry.mounts)


def parse_json(data: bytes, most: int, where: str) -> object:
    """Parse a document of at most ``most`` bytes.

    Raises:
        InfrastructureError: it is larger, or not valid JSON.
    """
    if len(data) > most:
        raise InfrastructureError(f"{where}: found {len(data)} bytes, at most {most} were expected")
    try:
        return json_file.parse_json(data)
    except (ValueError, RecursionError) as error:
        raise InfrastructureError(f"{where}: this is no JSON: {shorten(str(error), 200)}") from None


def _entry_of(container: Container, memory: int | None) -> _ContainerEntry:
    names = {each.name for each in fields(_ContainerEntry)}
    own = {name: value for name, value in vars(container).items() if name in names}
    readiness = container.readiness
    return _ContainerEntry(
        **own
        | {
            "environment": {k: v for k, v in container.environment.items() if k not in container.secrets},
            "seconds": container.limits.seconds,
            "memory": memory if container.limits.memory is None else container.limits.memory,
            "readiness": None if readiness is None else _ReadinessEntry(**vars(readiness)),
            "artifacts": tuple(_ArtifactEntry(**vars(artifact)) for artifact in container.artifacts),
        }
    )


def _container_of(entry: _ContainerEntry) -> Container:
    own = vars(entry).copy()
    limits = Limits(memory=own.pop("memory"), seconds=own.pop("seconds"))
    return Container(
        **own
        | {
            "image": "",
            "limits": limits,
            "readiness": None if entry.readiness is None else Readiness(**vars(entry.readiness)),
            "artifacts": tuple(Artifact(**vars(artifact)) for artifact in entry.artifacts),
        }
    )


@record(case="snake", nulls=True)
class _EndEntry:
    name: _Text = field()
    end: Annotated[str, Constraint(lambda value: value in set(End), " or ".join(End), whole=True)] = field()
    exit_code: _ExitCode | None = field()
    signal: Annotated[str, matching("SIG[A-Z0-9+]{1,20}", "a signal's name")] | None = field()
    seconds: _Seconds = field()


@record(case="snake", nulls=True)
class _FileEntry:
    path: Annotated[str, length(most=64 * 1024)] = field()
    container: _Text = field()
    size: _Count = field()
    sha256: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field()


@record(case="snake", nulls=True)
class _OutcomeEntry:
    schema: Literal[1] = field()
    job: _Text = field()
    attempt: _Count = field()
    exit_code: Annotated[int, between(0, max(ExitCode))] = field()
    reasons: Annotated[tuple[_Text, ...], length(most=_MOST_REASONS)] = field()
    seconds: _Seconds = field()
    containers: tuple[_EndEntry, ...] = field()
    artifacts: tuple[_FileEntry, ...] = field()
    left_out: tuple[_Text, ...] = field()


@dataclass(frozen=True)
class TaskOutcome:
    """Outcome of one attempt at a job."""

    job: str
    attempt: int
    """Counted from 1."""
    exit_code: ExitCode
    reasons: tuple[str, ...] = ()
    seconds: float = 0.0
    containers: tuple[ContainerOutcome, ...] = ()
    """Without logs and images, which the task does not know."""
    artifacts: tuple[ArtifactFile, ...] = ()
    left_out: tuple[str, ...] = ()


def most_bytes(job: Job) -> int:
    """Return the size limit of a job's outcome, to bound the download."""
    return _BYTES_EACH * (_MOST_REASONS + len(job.containers) + job.artifact_files)


def outcome_document(outcome: TaskOutcome) -> bytes:
    """Return the file of an outcome."""
    entry = _OutcomeEntry(
        schema=1,
        job=outcome.job,
        attempt=outcome.attempt,
        exit_code=int(outcome.exit_code),
        reasons=tuple(shorten(reason, _LONGEST) for reason in outcome.reasons[:_MOST_REASONS]),
        seconds=round(outcome.seconds, 3),
        containers=tuple(
            _EndEntry(c.name, c.end.value, c.exit_code, c.signal, round(c.seconds, 3)) for c in outcome.containers
        ),
        artifacts=tuple(_FileEntry(**vars(file)) for file in outcome.artifacts),
        left_out=tuple(shorten(note, _LONGEST) for note in outcome.left_out),
    )
    return json.dumps(document_of(entry), indent=1, allow_nan=False).encode()


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
    entry = read(_OutcomeEntry, parse_json(data, most_bytes(job), where), where, error=InfrastructureError)
    for key, found, expected in (("job", entry.job, job.name), ("attempt", entry.attempt, attempt)):
        if found != expected:
            raise place.below(key).unexpected(found, repr(expected))
    for key in ("artifacts", "left_out"):
        if len(getattr(entry, key)) > job.artifact_files:
            raise place.below(key).unexpected(list(getattr(entry, key)), f"at most {job.artifact_files}")
    outcome = TaskOutcome(
        job=job.name,
        attempt=attempt,
        exit_code=ExitCode(entry.exit_code),
        reasons=tuple(map(one_line, entry.reasons)),
        seconds=entry.seconds,
        containers=tuple(
            ContainerOutcome(c.name, End(c.end), c.exit_code, c.signal, c.seconds) for c in entry.containers
        ),
        artifacts=tuple(ArtifactFile(**vars(file)) for file in entry.artifacts),
        left_out=tuple(map(one_line, entry.left_out)),
    )
    if (outcome.exit_code == ExitCode.PASS) != (not outcome.reasons):
        raise place.below("exit_code").unexpected(entry.exit_code, "0 without reasons, another with some")
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
