"""The job of a task, watched to its end: containers started in order, stopped, judged, their artifacts copied."""

import json
import os
import re
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

from calibration.errors import CalibrationError, ExitCode
from calibration.execution.batch.documents import TaskOutcome
from calibration.execution.batch.inside.local_archive import opener_of
from calibration.execution.batch.inside.script import GRACE, LOG, READY_COMMAND, READY_FILE, Signs
from calibration.execution.batch.wire import ARRIVAL_SECONDS
from calibration.execution.bringing_out import Opener
from calibration.execution.job import Container, Job
from calibration.execution.job_check import start_order
from calibration.execution.judging import how_it_ended, is_running, unmet
from calibration.execution.log_file import LONGEST_LINE, MOST_BYTES
from calibration.execution.outcome import End
from calibration.execution.supervision import Supervised, Supervisor
from calibration.workflow.text import one_line

ADDRESS = "ECS_CONTAINER_METADATA_URI_V4"
"""The variable by which ECS tells each container where to ask."""
_SECONDS = 2.0
_MOST_BYTES = 4 * 1024**2


def ended_neighbours(variables: Mapping[str, str]) -> dict[str, int | None]:
    """The containers of this task that have ended, and with what exit code; none where nobody knows."""
    address = variables.get(ADDRESS, "")
    if not address.startswith("http://"):
        return {}
    try:
        with urlopen(f"{address}/task", timeout=_SECONDS) as answer:  # noqa: S310 (checked above)
            containers = json.loads(answer.read(_MOST_BYTES))["Containers"]
        return {
            str(each["Name"]): _code(each.get("ExitCode"))
            for each in containers
            if each.get("KnownStatus") == "STOPPED"
        }
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


def _code(value: object) -> int | None:
    return value if isinstance(value, int) else None


_CHUNK = 1024**2


class LogLine:
    """Looks for a regular expression in every line, each of which is read once."""

    def __init__(self, signs: Signs, name: str, pattern: str, most_bytes: int = MOST_BYTES) -> None:
        """Begin; of the file no more is kept on the volume than ``most_bytes``."""
        self.found = False
        self._signs = signs
        self._name = name
        self._pattern = re.compile(pattern)
        self._most = most_bytes
        self._position = 0
        self._rest = b""

    def look(self) -> bool:
        """Read on for a while; whether the line is there, or was."""
        descriptor = self._signs.open(self._name, LOG)
        if descriptor is not None:
            try:
                self._look(descriptor)
            finally:
                os.close(descriptor)
        return self.found

    def _look(self, descriptor: int) -> None:
        if self.found:
            self._position = os.fstat(descriptor).st_size
        else:
            data = os.pread(descriptor, _CHUNK, self._position)
            self._position += len(data)
            *lines, rest = (self._rest + data).split(b"\n")
            self._rest = rest[-LONGEST_LINE:]
            self.found = any(self._matches(line) for line in [*lines, *([rest] if len(rest) > LONGEST_LINE else [])])
        if self._position > self._most:  # it has been read, and who writes appends
            self._cut()
            self._position = 0

    def _cut(self) -> None:
        descriptor = self._signs.open(self._name, LOG, os.O_WRONLY)
        if descriptor is not None:
            os.ftruncate(descriptor, 0)
            os.close(descriptor)

    def _matches(self, line: bytes) -> bool:
        return self._pattern.search(line[:LONGEST_LINE].decode("utf-8", "replace")) is not None


SILENCE = 20.0
"""Seconds without a sign of life after which a container is gone: it gives two in a second."""
_CHECKED = ("port", "file", "command")
"""What a readiness may ask for; the line of the log is looked for apart."""
_CONNECTING = 0.5


class WatchedContainer(Supervised):
    """A container that is to run, runs, or did.

    It has no last line: its log is in CloudWatch, and may have secrets that the task does not know.
    """

    def __init__(self, container: Container, signs: Signs, silence: float = SILENCE) -> None:
        super().__init__(container)
        self._signs = signs
        self._silence = silence
        self._out_of_memory = False
        self._beat: tuple[int | None, float] = (None, time.monotonic())
        """The last sign of life, and when it was seen."""
        readiness = container.readiness
        self._line = LogLine(signs, self.name, readiness.log) if readiness and readiness.log else None
        self._unmet = {name for name in _CHECKED if getattr(readiness, name, None)}
        """What its readiness asks for and has not held."""

    @property
    def has_arrived(self) -> bool:
        """Whether it is there, and waits for being started."""
        return self._signs.beat(self.name) is not None

    def start(self) -> None:
        """Let it start its command.

        Raises:
            InfrastructureError: it cannot be told.
        """
        self._signs.start(self.name)
        self.started = time.monotonic()
        self._beat = (None, self.started)
        self.ready = self.container.readiness is None

    def look(self) -> None:
        """See whether it is ready, and whether it has ended."""
        if self.started is None or self.ended is not None:
            return
        if not self.ready or self._line is not None:
            self._look_whether_ready()
        ended = self._signs.ended(self.name)
        if ended is not None:
            self.exit_code, self._out_of_memory = ended
            self.ended = time.monotonic()
        elif self._is_silent():
            self.ended = time.monotonic()

    def not_ready_for(self) -> str:
        """What it is not ready for, for a message."""
        readiness = self.container.readiness
        return "" if readiness is None else unmet(readiness, self._unmet, self._line is None or self._line.found)

    def read_end(self, ours: End | None) -> None:
        """Conclude how it ended, as far as it was started.

        Args:
            ours: why we stopped it; None where it ended by itself.
        """
        if self.started is None:
            return
        if self.exit_code is None:
            self.end = ours or End.LOST
        else:
            self.end, self.signal = how_it_ended(self.container, self.exit_code, self._out_of_memory, ours)

    def _look_whether_ready(self) -> None:
        checks: dict[str, Callable[[], bool]] = {
            "port": self._port_answers,
            "file": lambda: self._signs.has(self.name, READY_FILE),
            "command": lambda: self._signs.has(self.name, READY_COMMAND),
        }
        self._unmet = {name for name in self._unmet if not checks[name]()}
        has_line = self._line is None or self._line.look()
        self.ready = not self._unmet and has_line

    def _port_answers(self) -> bool:
        """Whether a port of the task answers; its containers share an address."""
        readiness = self.container.readiness
        if readiness is None or readiness.port is None:
            raise AssertionError("there is a port to ask for")
        try:
            with socket.create_connection(("127.0.0.1", readiness.port), _CONNECTING):
                return True
        except OSError:
            return False

    def _is_silent(self) -> bool:
        """Whether it has given no sign of life for too long: all of it was killed."""
        now, beat = time.monotonic(), self._signs.beat(self.name)
        if beat != self._beat[0]:
            self._beat = (beat, now)
        return now - self._beat[1] > self._silence


_LOOKING = 0.2
"""Seconds between two looks at the containers."""
_ASKING = 5.0
"""Seconds between two questions after containers that do not come."""
_SETTLING = GRACE + 15
"""Seconds in which a container that was told to end does."""


@dataclass(frozen=True)
class Patience:
    """How long is waited for what containers do by themselves."""

    arrival: float = ARRIVAL_SECONDS
    silence: float = SILENCE
    settling: float = _SETTLING


class Watch(Supervisor[WatchedContainer]):
    """A job whose containers wait for being started."""

    def __init__(
        self,
        job: Job,
        signs: Signs,
        output: Path,
        patience: Patience = Patience(),
        neighbours: Callable[[], Mapping[str, int | None]] = dict,
    ) -> None:
        """Begin.

        Args:
            job: the job.
            signs: that its containers give.
            output: the job's volume, as it is mounted here.
            patience: for how long.
            neighbours: which containers have ended, as far as that can be asked, and their exit codes.
        """
        super().__init__(job, one_line)
        self._signs = signs
        self._output = output
        self._patience = patience
        self._neighbours = neighbours
        self.containers = [WatchedContainer(each, signs, patience.silence) for each in start_order(job)]
        self._settled = 0.0
        """When those that were told to end have had their time for it."""

    def run(self, folder: Path) -> None:
        """Watch the job until it has ended; what it leaves is in ``folder`` then, which is not there before.

        Raises:
            InfrastructureError: a sign cannot be given.
        """
        try:
            if self._all_arrive():
                self.judge.began = time.monotonic()
                self.supervise(folder)
        except CalibrationError as error:
            self.fail(error)
        finally:
            self._signs.stop()

    def fail(self, error: CalibrationError) -> None:
        """Take a reason why nothing can be brought out."""
        self.judge.fail(str(error), error.exit_code)
        self.artifacts, self.left_out = [], []

    def outcome(self, attempt: int) -> TaskOutcome:
        """What came of it."""
        return TaskOutcome(
            job=self.job.name,
            attempt=attempt,
            exit_code=self.judge.exit_code,
            reasons=tuple(self.judge.reasons),
            seconds=time.monotonic() - self.judge.began,
            containers=tuple(container.outcome() for container in self.containers),
            artifacts=tuple(self.artifacts),
            left_out=tuple(self.left_out),
        )

    def _all_arrive(self) -> bool:
        """Wait until all containers are there, so that none waits for an image while its job's time runs."""
        deadline = time.monotonic() + self._patience.arrival
        next_question = time.monotonic() + _ASKING
        while missing := [c.container.name for c in self.containers if not c.has_arrived]:
            now = time.monotonic()
            if now >= deadline:
                self._never_came(
                    f"within {self._patience.arrival:g} s nothing was heard of {_named(missing)}: its image"
                )
                return False
            if now >= next_question:
                next_question = now + _ASKING
                ended = self._neighbours()
                if gone := [name for name in missing if name in ended]:
                    code = "" if ended[gone[0]] is None else f" with exit code {ended[gone[0]]}"
                    self._never_came(f"container '{gone[0]}' ended at once{code}: its image")
                    return False
            time.sleep(_LOOKING)
        return True

    def _never_came(self, what: str) -> None:
        why = "cannot be pulled or has no /bin/sh, or its entrypoint does not run what it is given"
        self.judge.fail(f"{what} {why}", ExitCode.BAD_INPUT)

    def _start(self, container: WatchedContainer) -> None:
        container.start()

    def _wait(self, seconds: float | None) -> None:
        """Wait for the next look: nobody tells of an end."""
        time.sleep(_LOOKING if seconds is None else min(seconds, _LOOKING))

    def _stop(self, running: Sequence[WatchedContainer]) -> None:
        self._signs.stop()
        self._settled = time.monotonic() + self._patience.settling

    def _read_end(self, container: WatchedContainer, ours: End | None) -> None:
        """Wait for its end; a container that does not end is killed with the task."""
        while is_running(container) and time.monotonic() < self._settled:
            container.look()
            time.sleep(_LOOKING / 4)
        container.read_end(ours)

    def _opener(self, container: WatchedContainer) -> Opener:
        return opener_of(self._output)


def _named(names: Sequence[str]) -> str:
    return ("container " if len(names) == 1 else "containers ") + ", ".join(f"'{name}'" for name in names)
