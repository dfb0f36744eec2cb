"""Supervision of a job in its task: containers are started in order, stopped and judged, artifacts uploaded."""

import json
import os
import re
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

from calibration.addons.aws_batch.inside.local_archive import opener_of
from calibration.addons.aws_batch.inside.script import GRACE_SECONDS, LOG_FILE, READY_COMMAND, READY_FILE, Signs
from calibration.addons.aws_batch.wire import ARRIVAL_SECONDS, TaskOutcome
from calibration.base import CalibrationError, ExitCode, one_line
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.job_check import start_order
from calibration.ci.execution.outcome import End, Opener
from calibration.ci.execution.supervision import Supervised, Supervisor, how_it_ended, is_running, unmet
from calibration.ci.workflow.streams import LONGEST_LINE, MOST_BYTES

METADATA_VARIABLE = "ECS_CONTAINER_METADATA_URI_V4"
"""Environment variable with the URL of ECS's task metadata."""
_METADATA_TIMEOUT = 2.0
_MAX_METADATA_BYTES = 4 * 1024**2


def ended_neighbours(variables: Mapping[str, str]) -> dict[str, int | None]:
    """Return ended containers of this task with their exit codes, from ECS's metadata; empty if unavailable."""
    address = variables.get(METADATA_VARIABLE, "")
    if not address.startswith("http://"):
        return {}
    try:
        with urlopen(f"{address}/task", timeout=_METADATA_TIMEOUT) as answer:  # noqa: S310 (checked above)
            containers = json.loads(answer.read(_MAX_METADATA_BYTES))["Containers"]
        return {
            str(each["Name"]): code if isinstance(code := each.get("ExitCode"), int) else None
            for each in containers
            if each.get("KnownStatus") == "STOPPED"
        }
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


_CHUNK_BYTES = 1024**2


class LogLine:
    """Incremental search for a regular expression in the lines of a log."""

    def __init__(self, signs: Signs, name: str, pattern: str, most_bytes: int = MOST_BYTES) -> None:
        """Create the search; the log on the volume is truncated above ``most_bytes``."""
        self.found = False
        self._signs = signs
        self._name = name
        self._pattern = re.compile(pattern)
        self._most = most_bytes
        self._position = 0
        self._rest = b""

    def poll(self) -> bool:
        """Read new lines; return whether a line has matched."""
        descriptor = self._signs.open(self._name, LOG_FILE)
        if descriptor is not None:
            try:
                self._poll_log(descriptor)
            finally:
                os.close(descriptor)
        return self.found

    def _poll_log(self, descriptor: int) -> None:
        if self.found:
            self._position = os.fstat(descriptor).st_size
        else:
            data = os.pread(descriptor, _CHUNK_BYTES, self._position)
            self._position += len(data)
            *lines, rest = (self._rest + data).split(b"\n")
            self._rest = rest[-LONGEST_LINE:]
            self.found = any(
                self._pattern.search(line[:LONGEST_LINE].decode("utf-8", "replace"))
                for line in [*lines, *([rest] if len(rest) > LONGEST_LINE else [])]
            )
        if self._position > self._most:  # its content has been processed, and the writer appends
            self._truncate_log()
            self._position = 0

    def _truncate_log(self) -> None:
        descriptor = self._signs.open(self._name, LOG_FILE, os.O_WRONLY)
        if descriptor is not None:
            os.ftruncate(descriptor, 0)
            os.close(descriptor)


MAX_SILENCE_SECONDS = 20.0
"""Seconds without a heartbeat after which a container is lost; there are two heartbeats a second."""
_KINDS_OF_CHECKS = ("port", "file", "command")
"""Kinds of readiness beside the line of the log, which is checked separately."""
_CONNECT_TIMEOUT = 0.5


class WatchedContainer(Supervised):
    """A container of the job, before, during or after its run.

    It has no last line: its log is in CloudWatch, and may contain secrets that the task does not know.
    """

    def __init__(self, container: Container, signs: Signs, silence: float = MAX_SILENCE_SECONDS) -> None:
        super().__init__(container)
        self._signs = signs
        self._silence = silence
        self._out_of_memory = False
        self._beat: tuple[int | None, float] = (None, time.monotonic())
        """Last heartbeat, and when it was seen."""
        readiness = container.readiness
        self._line = LogLine(signs, self.name, readiness.log) if readiness and readiness.log else None
        self._unmet = {name for name in _KINDS_OF_CHECKS if getattr(readiness, name, None)}
        """Conditions of its readiness that have not been met."""

    @property
    def has_arrived(self) -> bool:
        """Whether its script runs, and waits for the permission to start."""
        return self._signs.beat(self.name) is not None

    def start(self) -> None:
        """Permit it to start its command.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self._signs.start(self.name)
        self.started = time.monotonic()
        self._beat = (None, self.started)
        self.ready = self.container.readiness is None

    def poll(self) -> None:
        """Update whether it is ready, and whether it has ended."""
        if self.started is None or self.ended is not None:
            return
        if not self.ready or self._line is not None:
            self._update_readiness()
        ended = self._signs.ended(self.name)
        if ended is not None:
            self.exit_code, self._out_of_memory = ended
            self.ended = time.monotonic()
        elif self._is_silent():
            self.ended = time.monotonic()

    def not_ready_for(self) -> str:
        """Return the unmet conditions of its readiness, for a message."""
        readiness = self.container.readiness
        return "" if readiness is None else unmet(readiness, self._unmet, self._line is None or self._line.found)

    def read_end(self, ours: End | None) -> None:
        """Determine how it ended, if it was started.

        Args:
            ours: reason why it was stopped; None if it ended by itself.
        """
        if self.started is None:
            return
        if self.exit_code is None:
            self.end = ours or End.LOST
        else:
            self.end, self.signal = how_it_ended(self.container, self.exit_code, self._out_of_memory, ours)

    def _update_readiness(self) -> None:
        checks: dict[str, Callable[[], bool]] = {
            "port": self._port_answers,
            "file": lambda: self._signs.has(self.name, READY_FILE),
            "command": lambda: self._signs.has(self.name, READY_COMMAND),
        }
        self._unmet = {name for name in self._unmet if not checks[name]()}
        has_line = self._line is None or self._line.poll()
        self.ready = not self._unmet and has_line

    def _port_answers(self) -> bool:
        """Return whether its port accepts connections; containers of a task share an address."""
        readiness = self.container.readiness
        if readiness is None or readiness.port is None:
            raise AssertionError("there is a port to ask for")
        try:
            with socket.create_connection(("127.0.0.1", readiness.port), _CONNECT_TIMEOUT):
                return True
        except OSError:
            return False

    def _is_silent(self) -> bool:
        """Return whether the heartbeat has stopped: all its processes were killed."""
        now, beat = time.monotonic(), self._signs.beat(self.name)
        if beat != self._beat[0]:
            self._beat = (beat, now)
        return now - self._beat[1] > self._silence


_POLL_SECONDS = 0.2
"""Interval of polls of the containers, seconds."""
_SECONDS_BETWEEN_REQUESTS = 5.0
"""Interval of requests to ECS about containers that have not arrived, seconds."""
_SETTLING_SECONDS = GRACE_SECONDS + 15
"""Seconds for a container to end after the request."""


@dataclass(frozen=True)
class WatchTimeouts:
    """Time-outs for containers, seconds."""

    arrival: float = ARRIVAL_SECONDS
    silence: float = MAX_SILENCE_SECONDS
    settling: float = _SETTLING_SECONDS


class Watch(Supervisor[WatchedContainer]):
    """Supervisor of a job whose containers wait for the permission to start."""

    def __init__(
        self,
        job: Job,
        signs: Signs,
        output: Path,
        timeouts: WatchTimeouts = WatchTimeouts(),
        neighbours: Callable[[], Mapping[str, int | None]] = dict,
    ) -> None:
        """Create the supervisor.

        Args:
            job: the job.
            signs: folder of signals of its containers.
            output: mount point of the job's volume.
            timeouts: time-outs of its containers.
            neighbours: returns the containers that have ended, and their exit codes.
        """
        super().__init__(job, one_line)
        self._signs = signs
        self._output = output
        self._timeouts = timeouts
        self._neighbours = neighbours
        self.containers = [WatchedContainer(each, signs, timeouts.silence) for each in start_order(job)]
        self._settled = 0.0
        """End of the time for containers to end after the request."""

    def run(self, folder: Path) -> None:
        """Supervise the job until it ends, and copy its artifacts to ``folder``, which must not exist.

        Raises:
            InfrastructureError: a signal cannot be written.
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
        """Record an error that makes the artifacts unusable."""
        self.judge.fail(str(error), error.exit_code)
        self.artifacts, self.left_out = [], []

    def outcome(self, attempt: int) -> TaskOutcome:
        """Return the outcome of the job."""
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
        """Wait until all scripts run, so that pulling images does not count for the job's time limit."""
        deadline = time.monotonic() + self._timeouts.arrival
        next_question = time.monotonic() + _SECONDS_BETWEEN_REQUESTS
        while missing := [c.container.name for c in self.containers if not c.has_arrived]:
            now = time.monotonic()
            if now >= deadline:
                self._never_came(f"within {self._timeouts.arrival:g} s {_list_names(missing)} did not start: its image")
                return False
            if now >= next_question:
                next_question = now + _SECONDS_BETWEEN_REQUESTS
                ended = self._neighbours()
                if gone := [name for name in missing if name in ended]:
                    code = "" if ended[gone[0]] is None else f" with exit code {ended[gone[0]]}"
                    self._never_came(f"container '{gone[0]}' ended at once{code}: its image")
                    return False
            time.sleep(_POLL_SECONDS)
        return True

    def _never_came(self, what: str) -> None:
        why = "cannot be pulled or has no /bin/sh, or its entrypoint does not execute its arguments"
        self.judge.fail(f"{what} {why}", ExitCode.BAD_INPUT)

    def _start(self, container: WatchedContainer) -> None:
        container.start()

    def _wait(self, seconds: float | None) -> None:
        """Wait until the next poll, because there are no notifications."""
        time.sleep(_POLL_SECONDS if seconds is None else min(seconds, _POLL_SECONDS))

    def _stop(self, running: Sequence[WatchedContainer]) -> None:
        self._signs.stop()
        self._settled = time.monotonic() + self._timeouts.settling

    def _read_end(self, container: WatchedContainer, ours: End | None) -> None:
        """Wait for the end of a container; if it does not end, it is killed with the task."""
        while is_running(container) and time.monotonic() < self._settled:
            container.poll()
            time.sleep(_POLL_SECONDS / 4)
        container.read_end(ours)

    def _opener(self, container: WatchedContainer) -> Opener:
        return opener_of(self._output)


def _list_names(names: Sequence[str]) -> str:
    return ("container " if len(names) == 1 else "containers ") + ", ".join(f"'{name}'" for name in names)
