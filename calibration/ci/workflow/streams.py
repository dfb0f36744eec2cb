"""Output of programs: live from several at once, kept apart, with workflow commands disabled; and as a file of a log.

In a file secrets are redacted, and its size is limited. Also the progress of long work.
"""

import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from calibration.base import InputError, one_line, shorten, without_escapes, writing
from calibration.base.text import Redactor
from calibration.ci.workflow.runner import Runner, group, stop_commands

MAX_SHOWN_CHARACTERS = 4 * 1024**2
"""Limit of characters of one stream; the rest is not shown."""
MAX_LINE_CHARACTERS = 2000
"""Limit of characters of a line."""
MOST_BYTES = 64 * 1024**2
"""Size limit of a log."""
LONGEST_LINE = 16 * 1024
"""Bytes; longer lines are processed in pieces."""


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


MAX_LOG_LINES = 40
"""Limit of lines in a log: with more steps, only every n-th step and those worth a message get a line."""


class Advance(Protocol):
    """Call by which work reports its progress, after each step."""

    def __call__(self, done: int, total: int, line: str, *, important: bool = False) -> None:
        """Report the number of finished steps, and a message about the last one, which may contain untrusted text."""


@contextmanager
def progress(runner: Runner, title: str, bar: bool = True, kept: str = "") -> Iterator[Advance]:
    """Show the progress of steps during the block.

    Args:
        runner: runner whose log shows it.
        title: title of the bar.
        bar: whether a bar may be shown on a terminal; False if other lines are printed in between.
        kept: plural of the steps ("poses") if an interruption preserves them: then their number is printed, but not
            after bad input, which the same command would find again.
    """
    finished = 0
    with _show_bar(runner, title) if bar and runner.on_terminal else _show_lines(runner) as show:

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            nonlocal finished
            finished = done
            show(done, total, line, important=important)

        try:
            yield advance
        except InputError:
            raise
        except BaseException:
            if kept and finished:
                runner.log(f"{finished} {kept} are done: the same command goes on from there")
            raise


@contextmanager
def _show_lines(runner: Runner) -> Iterator[Advance]:
    def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
        every = -(-total // MAX_LOG_LINES)
        if important or done % every == 0 or done == total:
            runner.log(f"[{done:>{len(str(total))}}/{total}] {one_line(line)}")

    yield advance


@contextmanager
def _show_bar(runner: Runner, title: str) -> Iterator[Advance]:
    """Show a bar during the block, and important messages above it."""
    # Here, as rich is slow to import, and a log needs none of it.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=runner.stdout)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # no monitor thread, so that the steps may fork
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as shown:
        task = shown.add_task(title, total=None)

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            shown.update(task, completed=done, total=total, refresh=True)
            if important:
                console.print(one_line(line), markup=False, highlight=False)

        yield advance


class LogFile:
    """Writes output to a log."""

    def __init__(
        self,
        path: Path,
        secrets: Iterable[str] = (),
        show: Callable[[str], None] | None = None,
        pattern: str | None = None,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        """Create the file.

        Args:
            path: path of the file.
            secrets: strings to redact.
            show: receives every line.
            pattern: regular expression to search in every line.
            most_bytes: size limit; the file states if it was truncated.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self.path = path
        self.last_line = ""
        """Last non-empty line, safe for a message."""
        self.found = False
        """Whether a line has matched the pattern."""
        self._redactor = Redactor(secrets)
        self._show = show
        self._pattern = re.compile(pattern) if pattern else None
        self._most = most_bytes
        self._written = 0
        self._left_out = 0
        self._rest = b""
        with writing(path, "the log"):
            self._file = path.open("wb", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def feed(self, data: bytes) -> None:
        """Add output.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self._take_within_limit(self._redactor.feed(data))

    def close(self) -> None:
        """Finish the log; idempotent.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        if self._file.closed:
            return
        try:
            self._take_within_limit(self._redactor.close())
            if self._rest:
                self._show_line(self._rest)
                self._rest = b""
            if self._left_out:
                self._write_bytes(f"\n(cut here: {self._left_out} more bytes were not kept)\n".encode())
        finally:
            self._file.close()

    def _take_within_limit(self, data: bytes) -> None:
        kept = data[: self._most - self._written]
        self._write_bytes(kept)
        self._written += len(kept)
        self._left_out += len(data) - len(kept)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._show_line(line)
        while len(self._rest) > LONGEST_LINE:
            self._show_line(self._rest[:LONGEST_LINE])
            self._rest = self._rest[LONGEST_LINE:]

    def _show_line(self, data: bytes) -> None:
        text = data[:LONGEST_LINE].decode("utf-8", "replace")
        if self._show is not None:
            self._show(text)
        if self._pattern is not None and not self.found:
            self.found = self._pattern.search(text) is not None
        if line := tame(text).strip():
            self.last_line = shorten(line, 200)

    def _write_bytes(self, data: bytes) -> None:
        with writing(self.path, "the log"):
            if data:
                self._file.write(data)
