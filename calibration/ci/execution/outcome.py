"""Outcome of a job, and its folder with the results, the same for all backends.

The folder has ``artifacts/``, ``logs/``, and ``manifest.json`` with the outcome: ``schema`` (1), ``job``, ``run``,
``verdict`` (pass or fail), ``exit_code`` (1, 2 or 3 for a fail), ``reasons`` (a line each), ``seconds``;
``containers``: ``name``, ``image`` (its id), ``end`` (a value of :class:`End`),
``exit_code``, ``signal``, ``seconds``, ``log`` (relative to the manifest); ``artifacts``: ``path`` (relative to
``artifacts/``), ``container``, ``size`` (bytes), ``sha256``; ``left_out``: links among the artifacts. It contains
nothing of a container's environment.
"""

import enum
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from calibration.base import ExitCode, write_atomically, writing
from calibration.base.records import Converted, between, field, length, matching, record


class End(enum.StrEnum):
    """Way in which a container ended."""

    EXITED = "exited"
    """Exited by itself."""
    SIGNALLED = "killed by a signal"
    """Killed by a signal, not by us."""
    OUT_OF_MEMORY = "out of memory"
    """Exceeded its memory, itself or one of its processes, whatever the exit code."""
    TIMED_OUT = "timed out"
    """Stopped at its time limit, or that of the job."""
    NOT_READY = "not ready"
    """Not ready in time, or ended before it was ready."""
    STOPPED = "stopped"
    """Stopped because the job was over."""
    NOT_STARTED = "not started"
    LOST = "lost"
    """Unknown, because the connection to the engine was lost."""


@record(case="snake", nulls=True)
class ContainerOutcome:
    """Outcome of one container: its end, exit code, duration and log."""

    name: Annotated[str, length(most=4096)] = field("Name of the container.")
    end: Annotated[End, Converted(Literal[tuple(map(str, End))], lambda end, _: End(end))] = field("How it ended.")
    exit_code: Annotated[int, between(0, 255)] | None = field("Its exit code, if it exited.", default=None)
    signal: Annotated[str, matching("SIG[A-Z0-9+]{1,20}", "a signal's name")] | None = field(
        "Signal that killed it, such as SIGKILL.", default=None
    )
    seconds: Annotated[float, between(0, 1e9)] = field("Duration.", default=0.0)
    log: Path | None = None
    """File with its output."""
    image: str = ""
    """Id of its image, if the backend knows it."""


@record(case="snake")
class ArtifactFile:
    """A file copied out of a container."""

    path: Annotated[str, length(most=64 * 1024)] = field("Path relative to the job's artifacts.")
    container: Annotated[str, length(most=4096)] = field("Name of the container.")
    size: Annotated[int, between(0, 2**63 - 1)] = field("Size in bytes.")
    sha256: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field("Digest of its content.")


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job."""

    job: str
    folder: Path
    """Contains ``artifacts/``, ``logs/<container>.log`` and ``manifest.json``."""
    containers: tuple[ContainerOutcome, ...] = ()
    artifacts: tuple[ArtifactFile, ...] = ()
    left_out: tuple[str, ...] = ()
    """Notes on artifacts that were not copied, a line each: links to other artifacts."""
    reasons: tuple[str, ...] = ()
    """Reasons of the failure, a line each, the cause first; empty if it succeeded."""
    exit_code: ExitCode = ExitCode.PASS
    """1 if the software in the containers failed (also: not ready, missing or unsafe artifacts), 2 if the
    job is wrong (unknown image or user), 3 for a failed infrastructure: engine, or time limit."""
    seconds: float = 0.0

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass if the exit code is 0."""
        return "pass" if self.exit_code == ExitCode.PASS else "fail"


ARTIFACTS_FOLDER, LOGS_FOLDER = "artifacts", "logs"
"""Subfolders of a job's folder."""
FILE_NAME = "manifest.json"


def make_job_folder(folder: Path) -> None:
    """Create a job's folder, without results of an earlier run.

    Raises:
        InfrastructureError: it cannot be written.
    """
    with writing(folder):
        for name in (ARTIFACTS_FOLDER, LOGS_FOLDER, FILE_NAME):
            place = folder / name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)
        (folder / LOGS_FOLDER).mkdir(parents=True)


def write_manifest(outcome: JobOutcome, run: str) -> None:
    """Write the manifest of a job into its folder.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = {
        "schema": 1,
        "job": outcome.job,
        "run": run,
        "verdict": outcome.verdict,
        "exit_code": int(outcome.exit_code),
        "reasons": outcome.reasons,
        "seconds": round(outcome.seconds, 3),
        "containers": [
            {
                "name": container.name,
                "image": container.image,
                "end": container.end.value,
                "exit_code": container.exit_code,
                "signal": container.signal,
                "seconds": round(container.seconds, 3),
                "log": None if container.log is None else container.log.relative_to(outcome.folder).as_posix(),
            }
            for container in outcome.containers
        ],
        "artifacts": [
            {"path": file.path, "container": file.container, "size": file.size, "sha256": file.sha256}
            for file in outcome.artifacts
        ],
        "left_out": outcome.left_out,
    }
    write_atomically(outcome.folder / FILE_NAME, json.dumps(document, indent=1, allow_nan=False) + "\n")
