"""How the containers of a task tell each other where they are: files in a folder that all of them see.

::

    NAME.sh               what container NAME runs; written before it starts
    start/NAME            it may start its command; written by who watches
    stop                  all have to end; written by who watches
    state/NAME/           written by container NAME, as whatever user it is:
        beat              is written again and again for as long as it is there
        pid               of its command, which runs then
        ready.file        the file that it is ready by is there
        ready.command     the command that it is ready by has answered 0
        log, pipe         its output, where it is ready by a line of it
        ended             exit code of its command, and how many of its processes ran out of memory
"""

import os
import stat
from contextlib import suppress
from pathlib import Path

from calibration.errors import WorldError
from calibration.execution.job import Job

STOP, START, STATE = "stop", "start", "state"
BEAT, PID, READY_FILE, READY_COMMAND, LOG, PIPE, ENDED = (
    "beat",
    "pid",
    "ready.file",
    "ready.command",
    "log",
    "pipe",
    "ended",
)
_MOST_BYTES = 100
"""Of a sign."""


class Signs:
    """The folder, as our own containers see it. Those of the job may have put anything into what they can write."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def make(self, job: Job) -> None:
        """Make what the containers of a job write to.

        Raises:
            WorldError: it cannot be made.
        """
        try:
            (self.folder / START).mkdir(parents=True, exist_ok=True)
            for container in job.containers:
                state = self.folder / STATE / container.name
                state.mkdir(parents=True, exist_ok=True)
                state.chmod(0o1777)  # its user is whatever the image says
        except OSError as error:
            raise WorldError(f"{self.folder}: cannot be written: {error.strerror or error}") from error

    def start(self, name: str) -> None:
        """Let a container start.

        Raises:
            WorldError: it cannot be written.
        """
        self._write(self.folder / START / name)

    def stop(self) -> None:
        """Ask all containers to end.

        Raises:
            WorldError: it cannot be written.
        """
        self._write(self.folder / STOP)

    def has(self, name: str, sign: str) -> bool:
        """Whether a container has given a sign."""
        return os.path.lexists(self.folder / STATE / name / sign)

    def beat(self, name: str) -> int | None:
        """What changes for as long as a container is there; None before it is."""
        with suppress(OSError):
            return os.lstat(self.folder / STATE / name / BEAT).st_mtime_ns
        return None

    def ended(self, name: str) -> tuple[int, bool] | None:
        """The exit code of a container's command, and whether memory ran out; None where it has not ended."""
        descriptor = self.open(name, ENDED)
        if descriptor is None:
            return None
        with os.fdopen(descriptor, "rb") as file:
            words = file.read(_MOST_BYTES).split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            return None  # it is being written; or it is wrong for ever, and the container silent soon
        return int(words[0]) & 0xFF, int(words[1]) > 0

    def open(self, name: str, sign: str, access: int = os.O_RDONLY) -> int | None:
        """A descriptor of a regular file in the state of a container; None where there is none."""
        flags = access | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            descriptor = os.open(self.folder / STATE / name / sign, flags)
        except OSError:
            return None
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)
        return None

    def _write(self, path: Path) -> None:
        try:
            path.touch()
        except OSError as error:
            raise WorldError(f"{path}: cannot be written: {error.strerror or error}") from error
