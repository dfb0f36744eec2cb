"""One container of the job, as seen by who watches it: by the signs that it gives."""

import socket
import time
from collections.abc import Callable

from calibration.execution.batch.inside.log_line import LogLine
from calibration.execution.batch.inside.signs import READY_COMMAND, READY_FILE, Signs
from calibration.execution.job import Container
from calibration.execution.judging import how_it_ended, unmet
from calibration.execution.outcome import End
from calibration.execution.supervision import Supervised

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
            WorldError: it cannot be told.
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
