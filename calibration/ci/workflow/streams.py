"""Live output of several concurrent programs, kept apart, with workflow commands disabled."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from calibration.base.text import one_line, shorten, without_escapes
from calibration.ci.workflow.runner import Runner, group, stop_commands

MAX_SHOWN_CHARACTERS = 4 * 1024**2
"""Limit of characters of one stream; the rest is not shown."""
MAX_LINE_CHARACTERS = 2000
"""Limit of characters of a line."""


class LogStream:
    """Output lines of one program. Thread-safe."""

    def __init__(self, display: "LogDisplay", title: str, live: bool) -> None:
        self.title = one_line(title)
        self.live = live
        self.waiting: list[str] = []
        """Lines that have not been printed yet."""
        self.closed = False
        self.printed = False
        self._display = display
        self._room = MAX_SHOWN_CHARACTERS

    def line(self, text: str) -> None:
        """Print a line as soon as its stream may be shown."""
        if self._room <= 0:
            return
        text = tame(text)
        self._room -= len(text) + 1
        more = [] if self._room > 0 else ["(more is not shown here, see the file of the log)"]
        self._display.show(self, [text, *more])

    def close(self) -> None:
        """Mark the end of the stream."""
        self._display.finish(self)


class LogDisplay:
    """Shows the output lines of several concurrent programs.

    On a terminal each line starts with the program's title. In the log of a CI service each program has a
    group; only one group can be open, so one program is shown live, and the lines of the others
    follow in one piece when they have ended. Workflow commands are disabled in all of it.
    """

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._lock = threading.RLock()
        self._streams: list[LogStream] = []
        self._group: ExitStack | None = None
        """The open group in the log of a CI service."""
        self._in_group: LogStream | None = None
        self._paused = 0
        self._broken = False

    def open(self, title: str, *, live: bool = True) -> LogStream:
        """Begin a stream; in the log of a CI service one that is not ``live`` is shown only when it has ended."""
        stream = LogStream(self, title, live)
        with self._lock:
            self._streams.append(stream)
        return stream

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Allow other output in the block, including workflow commands: no lines are shown and no group is open."""
        with self._lock:
            self._paused += 1
            self._close_group()
        try:
            yield
        finally:
            with self._lock:
                self._paused -= 1
                self._print_what_may()

    def note(self, text: str) -> None:
        """Print a line of our own between those of the programs."""
        with self.paused():
            if not self._broken:
                try:
                    self._runner.log(one_line(text))
                except (OSError, ValueError):
                    self._broken = True

    def show(self, stream: LogStream, lines: list[str]) -> None:
        """Receive lines of a stream."""
        with self._lock:
            stream.waiting += lines
            self._print_what_may()

    def finish(self, stream: LogStream) -> None:
        """Receive the end of a stream."""
        with self._lock:
            stream.closed = True
            self._print_what_may()

    def _print_what_may(self) -> None:
        if self._paused or self._broken:
            return
        try:
            if self._runner.service.interactive:
                for stream in self._streams:
                    self._print_waiting(stream, f"{stream.title} | ")
            else:
                self._print_in_groups()
        except (OSError, ValueError):  # closed pipe or stream: must not fail the program
            self._broken = True
        self._streams = [stream for stream in self._streams if stream.waiting or not stream.closed]

    def _print_in_groups(self) -> None:
        current = self._in_group
        if current is not None:
            self._print_waiting(current)
            if not current.closed:
                return
            self._close_group()
        for stream in self._streams:
            if stream.closed and stream.waiting:
                self._open_group(stream)
                self._print_waiting(stream)
                self._close_group()
        following = next((stream for stream in self._streams if stream.live and stream.waiting), None)
        if following is not None:
            self._open_group(following)
            self._print_waiting(following)

    def _open_group(self, stream: LogStream) -> None:
        self._group, self._in_group = ExitStack(), stream
        title = f"{stream.title} (continued)" if stream.printed else stream.title
        self._group.enter_context(group(self._runner, title))
        self._group.enter_context(stop_commands(self._runner))
        stream.printed = True

    def _close_group(self) -> None:
        if self._group is not None:
            opened, self._group, self._in_group = self._group, None, None
            opened.close()

    def _print_waiting(self, stream: LogStream, prefix: str = "") -> None:
        lines, stream.waiting = stream.waiting, []
        if lines:
            self._runner.log("\n".join(prefix + line for line in lines))


def tame(text: str) -> str:
    """Make a line of untrusted output safe for the log: as a terminal would show it, without colours, truncated.

    Of a progress bar, which uses carriage returns, the last state is kept.
    """
    text = text.rstrip().rpartition("\r")[2].expandtabs(4)
    text = without_escapes(text)
    words = text.lstrip(" ")
    return " " * min(len(text) - len(words), MAX_LINE_CHARACTERS // 4) + one_line(shorten(words, MAX_LINE_CHARACTERS))
