"""``outcome.json``: what a task says of its job, written last; read by the client, which believes none of it."""

import json
import re
from dataclasses import dataclass

from calibration.errors import ExitCode, WorldError
from calibration.execution.batch.documents.fields import Fields, parse_json
from calibration.execution.extraction import RefusedError, path_parts
from calibration.execution.job import Job
from calibration.execution.outcome import BroughtOut, ContainerOutcome, End
from calibration.workflow.text import one_line, shorten

SCHEMA = 1
_BYTES_EACH = 8192
"""More than any line of it needs."""
_MOST_REASONS = 1000
_LONGEST_REASON = 4096
_SIGNAL = re.compile(r"SIG[A-Z0-9+]{1,20}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class TaskOutcome:
    """What came of one attempt at a job."""

    job: str
    attempt: int
    """From 1."""
    exit_code: ExitCode
    reasons: tuple[str, ...] = ()
    seconds: float = 0.0
    containers: tuple[ContainerOutcome, ...] = ()
    """Without logs and images, of which the task knows nothing."""
    artifacts: tuple[BroughtOut, ...] = ()
    left_out: tuple[str, ...] = ()


def most_bytes(job: Job) -> int:
    """How large the outcome of a job may be: nothing larger has to be downloaded."""
    return _BYTES_EACH * (_MOST_REASONS + len(job.containers) + job.artifact_files)


def outcome_document(outcome: TaskOutcome) -> bytes:
    """The file of an outcome."""
    document = {
        "schema": SCHEMA,
        "job": outcome.job,
        "attempt": outcome.attempt,
        "exit_code": int(outcome.exit_code),
        "reasons": [shorten(reason, _LONGEST_REASON) for reason in outcome.reasons[:_MOST_REASONS]],
        "seconds": round(outcome.seconds, 3),
        "containers": [
            {
                "name": container.name,
                "end": container.end.value,
                "exit_code": container.exit_code,
                "signal": container.signal,
                "seconds": round(container.seconds, 3),
            }
            for container in outcome.containers
        ],
        "artifacts": [
            {"path": file.path, "container": file.container, "size": file.size, "sha256": file.sha256}
            for file in outcome.artifacts
        ],
        "left_out": [shorten(note, _LONGEST_REASON) for note in outcome.left_out],
    }
    return json.dumps(document, indent=1, allow_nan=False).encode()


def read_outcome(data: bytes, job: Job, attempt: int, where: str) -> TaskOutcome:
    """Read the outcome of an attempt at a job.

    Args:
        data: the file.
        job: that it has to be of; what it left may not exceed the job's limits.
        attempt: that it has to be of.
        where: the file's name, for messages.

    Raises:
        WorldError: it is none, or contradicts the job or itself.
    """
    fields = Fields(parse_json(data, most_bytes(job), where), where)
    fields.integer("schema", SCHEMA, SCHEMA)
    if (name := fields.text("job")) != job.name:
        raise fields.wrong("job", name, repr(job.name))
    outcome = TaskOutcome(
        job=name,
        attempt=fields.integer("attempt", attempt, attempt),
        exit_code=ExitCode(fields.integer("exit_code", 0, max(ExitCode))),
        reasons=_lines(fields, "reasons", _MOST_REASONS),
        seconds=fields.seconds("seconds"),
        containers=fields.objects("containers", len(job.containers), _container),
        artifacts=fields.objects("artifacts", job.artifact_files, _artifact),
        left_out=_lines(fields, "left_out", job.artifact_files),
    )
    fields.end()
    if (outcome.exit_code == ExitCode.PASS) != (not outcome.reasons):
        raise fields.wrong("exit_code", int(outcome.exit_code), "0 without reasons, another with some")
    _check_containers(outcome, job, where)
    _check_artifacts(outcome, job, where)
    return outcome


def _lines(fields: Fields, name: str, most: int) -> tuple[str, ...]:
    return tuple(one_line(line) for line in fields.texts(name, most, _LONGEST_REASON))


def _container(fields: Fields) -> ContainerOutcome:
    end = fields.text("end")
    if end not in set(End):
        raise fields.wrong("end", end, " or ".join(End))
    signal = fields.optional_text("signal", 20)
    if signal is not None and not _SIGNAL.fullmatch(signal):
        raise fields.wrong("signal", signal, "a signal's name")
    return ContainerOutcome(
        name=fields.text("name"),
        end=End(end),
        exit_code=fields.optional_integer("exit_code", 0, 255),
        signal=signal,
        seconds=fields.seconds("seconds"),
    )


def _artifact(fields: Fields) -> BroughtOut:
    path = fields.text("path", 64 * 1024)
    try:
        parts = path_parts(path)
    except RefusedError as error:
        raise WorldError(f"{fields.where}: {error}") from None
    if "/".join(parts) != path:
        raise fields.wrong("path", path, "a plain path")
    sha256 = fields.text("sha256", 64)
    if not _SHA256.fullmatch(sha256):
        raise fields.wrong("sha256", sha256, "64 hexadecimal digits")
    return BroughtOut(path, fields.text("container"), fields.integer("size"), sha256)


def _check_containers(outcome: TaskOutcome, job: Job, where: str) -> None:
    found, expected = [c.name for c in outcome.containers], [c.name for c in job.containers]
    if sorted(found) != sorted(expected):
        raise WorldError(f"{where}: containers: found {shorten(str(found))}, expected {shorten(str(expected))}")
    if outcome.exit_code == ExitCode.PASS:
        _check_passed(outcome, job, where)


def _check_passed(outcome: TaskOutcome, job: Job, where: str) -> None:
    """An essential container has ended well, and none otherwise."""
    its = {container.name: container for container in outcome.containers}
    essential = [container for container in job.containers if container.essential]
    ended = [c for c in essential if its[c.name].end != End.STOPPED]
    for container in ended:
        end, code = its[container.name].end, its[container.name].exit_code
        if end != End.EXITED or code not in container.success:
            raise WorldError(
                f"{where}: the job is said to have passed, but container '{container.name}' {end} with exit code {code}"
            )
    if not ended:
        raise WorldError(f"{where}: the job is said to have passed, but no essential container ended")


def _check_artifacts(outcome: TaskOutcome, job: Job, where: str) -> None:
    if (size := sum(file.size for file in outcome.artifacts)) > job.artifact_bytes:
        raise WorldError(f"{where}: artifacts: found {size} bytes, at most {job.artifact_bytes} were expected")
    names = {container.name for container in job.containers}
    paths: set[str] = set()
    for file in outcome.artifacts:
        if file.container not in names:
            raise WorldError(f"{where}: artifacts: there is no container '{shorten(file.container)}'")
        if file.path in paths:
            raise WorldError(f"{where}: artifacts: '{file.path}' stands there twice")
        paths.add(file.path)
    for file in outcome.artifacts:
        parts = file.path.split("/")
        for count in range(1, len(parts)):
            if (folder := "/".join(parts[:count])) in paths:
                raise WorldError(f"{where}: artifacts: '{folder}' is a folder and a file")
