"""What came of a job, whatever the backend."""

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from calibration.errors import ExitCode


class End(enum.StrEnum):
    """How a container ended."""

    EXITED = "exited"
    """By itself, with an exit code."""
    SIGNALLED = "killed by a signal"
    """Not by us."""
    OUT_OF_MEMORY = "out of memory"
    """It, or one of its processes, exceeded its memory; whatever its exit code says."""
    TIMED_OUT = "timed out"
    """We stopped it at its limit or the job's."""
    NOT_READY = "not ready"
    """It did not become ready in time, or ended before."""
    STOPPED = "stopped"
    """By us, because the job had ended."""
    NOT_STARTED = "not started"
    LOST = "lost"
    """The engine cannot say: the connection broke."""


@dataclass(frozen=True)
class ContainerOutcome:
    """How one container ended."""

    name: str
    end: End
    exit_code: int | None = None
    signal: str | None = None
    """``SIGKILL``, where it was killed by one."""
    seconds: float = 0.0
    log: Path | None = None
    """The file of its output."""
    image: str = ""
    """The id of the image that it was made from, where the backend knows it."""


@dataclass(frozen=True)
class BroughtOut:
    """A file that came out of a container."""

    path: str
    """Relative to the job's folder of artifacts."""
    container: str
    size: int
    """Bytes."""
    sha256: str


@dataclass(frozen=True)
class JobOutcome:
    """What came of a job."""

    job: str
    folder: Path
    """Has ``artifacts/``, ``logs/<container>.log`` and ``manifest.json``."""
    containers: tuple[ContainerOutcome, ...] = ()
    artifacts: tuple[BroughtOut, ...] = ()
    left_out: tuple[str, ...] = ()
    """What was among the artifacts but not brought out, a line each: links to others of them."""
    reasons: tuple[str, ...] = ()
    """Why it failed, a line each, the cause first; none where it succeeded."""
    exit_code: ExitCode = ExitCode.PASS
    """1 where the software in the containers failed (it never got ready, it left no artifact or a hostile one), 2
    where the job is wrong (no such image or user), 3 where infrastructure failed: the engine, or the time."""
    seconds: float = 0.0

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass where nothing speaks against it."""
        return "pass" if self.exit_code == ExitCode.PASS else "fail"
