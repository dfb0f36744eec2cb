"""Jobs as a task reads them in S3: ``jobs/GROUP/NNNNN.json``, a list with an object for each.

An entry has what differs between jobs of one shape, and nothing that is secret: of a secret variable there is neither
name nor value, since AWS Batch puts it into the container's environment by itself.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from calibration.errors import WorldError
from calibration.execution.batch.documents.fields import Fields, parse_json
from calibration.execution.job import Artifact, Container, Job, Limits, Readiness
from calibration.execution.job_check import NAME

MOST_BYTES = 64 * 1024**2
"""Of a file of jobs."""
_MOST = 1000
"""Containers, mounts, artifacts of a job."""


@dataclass(frozen=True)
class Input:
    """What one volume of a job holds when its containers start."""

    volume: int
    """Its place among `mount_targets`."""
    key: str
    """Of the tar in the bucket."""
    sha256: str
    """Of the tar."""
    size: int
    """Of the tar, in bytes."""
    writable: bool = False
    """Whether a container writes to it."""


@dataclass(frozen=True)
class TaskJob:
    """A job as the task has it: its containers have no image, user or mounts, and no secrets."""

    job: Job
    inputs: tuple[Input, ...] = ()


def mount_targets(job: Job) -> tuple[str, ...]:
    """Where the volumes of a job are mounted, each once; the place in it is the number of the volume."""
    return tuple(sorted({mount.target.rstrip("/") for container in job.containers for mount in container.mounts}))


def job_entry(job: Job, inputs: Iterable[Input], memory: int | None = None) -> dict[str, Any]:
    """The entry of a job.

    Args:
        job: the job.
        inputs: what its volumes hold.
        memory: bytes, of a container that says none.
    """
    return {
        "job": job.name,
        "seconds": job.seconds,
        "artifact_bytes": job.artifact_bytes,
        "artifact_files": job.artifact_files,
        "containers": [_container_entry(container, memory) for container in job.containers],
        "mounts": [
            {
                "volume": item.volume,
                "key": item.key,
                "sha256": item.sha256,
                "size": item.size,
                "writable": item.writable,
            }
            for item in inputs
        ],
    }


def jobs_document(entries: Sequence[dict[str, Any]]) -> bytes:
    """The file of some jobs: the same bytes for the same jobs."""
    return json.dumps(entries, separators=(",", ":"), sort_keys=True, allow_nan=False).encode()


def read_job(data: bytes, index: int, where: str) -> TaskJob:
    """Read one job of a file.

    Args:
        data: the file.
        index: the place of the job in it.
        where: the file's name, for messages.

    Raises:
        WorldError: it is not what `jobs_document` writes, or has no such job.
    """
    document = parse_json(data, MOST_BYTES, where)
    if not isinstance(document, list) or not 0 <= index < len(document):
        raise WorldError(f"{where}: there is no job {index} in it")
    fields = Fields(document[index], f"{where}: job {index}")
    job = Job(
        name=fields.text("job"),
        seconds=fields.optional_seconds("seconds"),
        artifact_bytes=fields.integer("artifact_bytes"),
        artifact_files=fields.integer("artifact_files"),
        containers=fields.objects("containers", _MOST, _container),
    )
    inputs = fields.objects("mounts", _MOST, _input)
    fields.end()
    return TaskJob(job, inputs)


def _container_entry(container: Container, memory: int | None) -> dict[str, Any]:
    readiness = container.readiness
    return {
        "name": container.name,
        "command": list(container.command),
        "entrypoint": None if container.entrypoint is None else list(container.entrypoint),
        "environment": {name: value for name, value in container.environment.items() if name not in container.secrets},
        "working_directory": container.working_directory,
        "after": list(container.after),
        "essential": container.essential,
        "success": list(container.success),
        "seconds": container.limits.seconds,
        "memory": memory if container.limits.memory is None else container.limits.memory,
        "readiness": None
        if readiness is None
        else {
            "port": readiness.port,
            "log": readiness.log,
            "file": readiness.file,
            "command": list(readiness.command),
            "seconds": readiness.seconds,
        },
        "artifacts": [{"path": artifact.path, "required": artifact.required} for artifact in container.artifacts],
    }


def _container(fields: Fields) -> Container:
    seconds = fields.optional_seconds("seconds")
    return Container(
        name=_name(fields),
        image="",
        command=fields.texts("command"),
        entrypoint=fields.optional_texts("entrypoint"),
        environment=fields.variables("environment"),
        working_directory=fields.optional_text("working_directory"),
        limits=Limits(memory=fields.optional_integer("memory"), seconds=seconds),
        readiness=fields.optional_object("readiness", _readiness),
        after=fields.texts("after"),
        essential=fields.yes_or_no("essential"),
        success=fields.integers("success", 0, 255),
        artifacts=fields.objects("artifacts", _MOST, lambda a: Artifact(a.text("path"), a.yes_or_no("required"))),
    )


def _name(fields: Fields) -> str:
    """The name of a container, which is the name of files."""
    name = fields.text("name")
    if not NAME.fullmatch(name):
        raise fields.wrong("name", name, "the name of a container")
    return name


def _readiness(fields: Fields) -> Readiness:
    return Readiness(
        port=fields.optional_integer("port", 1, 65535),
        log=fields.optional_text("log"),
        file=fields.optional_text("file"),
        command=fields.texts("command"),
        seconds=fields.seconds("seconds"),
    )


def _input(fields: Fields) -> Input:
    return Input(
        volume=fields.integer("volume", 0, _MOST),
        key=fields.text("key"),
        sha256=fields.text("sha256", 64),
        size=fields.integer("size"),
        writable=fields.yes_or_no("writable"),
    )
