"""Outcome of a job, the same for all backends."""

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from calibration.base.errors import ExitCode
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
