"""Run of the team's tests with measurement; the verdict follows from the exit code and the number of tests."""

import json
import os
import re
import selectors
import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.addons.coverage.command import CommandOfTests
from calibration.addons.coverage.data_file import measured_names
from calibration.addons.coverage.formats import MAX_BYTES
from calibration.addons.coverage.injection import bring_coverage, measuring, write_settings
from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import read_bytes
from calibration.base.programs import has_ended, started
from calibration.base.records import computed, field, result
from calibration.base.text import one_line, shorten
from calibration.ci.execution.log_file import LogFile
from calibration.ci.report.xunit_reading import Tally, read_test_report
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.streams import LogDisplay

_SECONDS_BETWEEN_POLLS = 0.1
LOST_PROCESS = (
    "what one process of the tests has run is lost: it was ended, or its disk was full, while it wrote that down"
)


def run(
    arguments: Sequence[str],
    directory: Path,
    environment: Mapping[str, str],
    seconds: float,
    feed: Callable[[bytes], None],
) -> int:
    """Run a program and return its exit code (negative: number of the signal that ended it).

    Remaining processes of its process group are ended too, also after an interruption.

    Args:
        arguments: program and arguments.
        directory: working directory.
        environment: all environment variables.
        seconds: time limit.
        feed: called with its output and errors as they arrive.

    Raises:
        InputError: it cannot be started.
        InfrastructureError: it exceeds the time limit.
    """
    deadline = time.monotonic() + seconds
    with ExitStack() as stack, selectors.DefaultSelector() as selector:
        try:
            process = stack.enter_context(started(arguments, environment, directory))
        except (OSError, ValueError) as error:
            raise InputError(f"run: {arguments[0]} cannot be started: {error}") from None
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        selector.register(process.stdout, selectors.EVENT_READ)
        more = True
        while True:
            if time.monotonic() > deadline:
                raise InfrastructureError(f"the tests took longer than {seconds:g} s (timeout) and were stopped")
            if more and selector.select(_SECONDS_BETWEEN_POLLS):
                data = os.read(process.stdout.fileno(), 64 * 1024)
                feed(data)
                more = bool(data)
            elif has_ended(process):  # its child processes may continue, and keep the pipe open
                break
            elif not more:
                time.sleep(_SECONDS_BETWEEN_POLLS)
    return process.returncode


_RAN_LINE = re.compile(r"Ran ([0-9]{1,9}) tests? in ")
_FAILED_LINE = re.compile(r"FAILED \((.*)\)")
_SKIPPED_COUNT = re.compile(r"(?:OK|FAILED) \(.*?skipped=([0-9]{1,9})")
_FAILURE_COUNT = re.compile(r"(?:failures|errors)=([0-9]{1,9})")


@result
class Tests:
    """Outcome of the tests."""

    __test__ = False  # keeps pytest from collecting it

    command: str = field("The command that ran them.")
    exit_code: int = field("Below 0: of the signal that killed them.")
    seconds: float = field("How long they took.")
    tally: Tally | None = None
    """Numbers of tests; None if unknown."""

    @property
    @computed()
    def passed(self) -> int | None:
        """Number of tests that passed; null if unknown."""
        return self.tally.passed if self.tally else None

    @property
    @computed()
    def failed(self) -> int | None:
        """Number of tests that failed or could not run; null if unknown."""
        return self.tally.failed if self.tally else None

    @property
    @computed()
    def skipped(self) -> int | None:
        """Number of skipped tests; null if unknown."""
        return self.tally.skipped if self.tally else None

    @property
    def problem(self) -> str | None:
        """Reason why the tests did not pass; None if they did."""
        if self.exit_code < 0:
            return f"the tests were killed by {_signal_name(-self.exit_code)}"
        if self.tally is not None and self.tally.ran == 0:  # the exit code is 5 for pytest, and 0 or 5 for unittest
            return f"no test ran{f' ({self.tally.skipped} were skipped)' if self.tally.skipped else ''}"
        if self.exit_code:
            counted = f", {self.tally.failed} of {self.tally.ran} failed" if self.tally and self.tally.failed else ""
            return f"the tests failed: exit code {self.exit_code}{counted}"
        if self.tally is not None and self.tally.failed:
            return f"{self.tally.failed} of {self.tally.ran} tests failed, though the exit code is 0"
        return None


@dataclass(frozen=True)
class Measurement:
    """Files that coverage.py left after a run."""

    files: tuple[Path, ...]
    """Data files."""
    executable: str | None = None
    """The newest Python that measured."""
    problems: tuple[str, ...] = ()
    """Problems of the measurement, a line for each."""


def run_tests(
    command: CommandOfTests,
    directory: Path,
    environment: Mapping[str, str],
    seconds: float,
    runner: Runner,
    log: Path,
    secrets: Iterable[str] = (),
) -> Tests:
    """Run the tests; their output is shown live and written to a file.

    Args:
        command: command to run.
        directory: working directory.
        environment: all environment variables.
        seconds: time limit.
        runner: for the log.
        log: log file.
        secrets: values to mask in log and output.

    Raises:
        InputError: the command cannot be started, or its JUnit file is malformed.
        InfrastructureError: the time limit is exceeded.
    """
    if command.junit is not None:
        command.junit.unlink(missing_ok=True)  # else the result of an earlier run might be read
    display = LogDisplay(runner)
    stream = display.open(shorten(command.text, 60))
    count = _Unittest()

    def show(line: str) -> None:
        count.line(line)
        stream.line(line)

    begin = time.monotonic()
    log.parent.mkdir(parents=True, exist_ok=True)
    try:
        with LogFile(log, secrets, show) as file:
            code = run(command.arguments, directory, environment, seconds, file.feed)
    finally:
        stream.close()
    tally = count.tally()
    if command.junit is not None and command.junit.exists():
        data = read_bytes(command.junit, MAX_BYTES, "JUnit XML")
        tally = Tally.of(read_test_report(data, str(command.junit)))
    return Tests(command.text, code, round(time.monotonic() - begin, 3), tally)


def measured_environment(
    environment: Mapping[str, str], settings: Mapping[str, Any], sources: Iterable[str], folder: Path
) -> dict[str, str]:
    """Prepare a folder for the measurement, and return the environment that enables it.

    Args:
        environment: environment of this process.
        settings: the team's settings of coverage.py.
        sources: folders and packages to measure.
        folder: created, for all files of the measurement.
    """
    for name in ("data", "notes"):
        (folder / name).mkdir(parents=True)
    concurrency = settings.get("run:concurrency")
    configuration = folder / "settings"
    write_settings(
        configuration,
        {
            **{name: value for name, value in settings.items() if not name.startswith("report:")},
            "run:branch": True,
            "run:parallel": True,
            "run:data_file": str(folder / "data" / ".coverage"),
            "run:source": list(sources),
            "run:concurrency": _with_multiprocessing(concurrency),
            "run:disable_warnings": ["no-ctracer", "couldnt-parse", "no-sysmon"],
        },
    )
    return measuring(environment, configuration, folder / "notes", bring_coverage(folder))


def measurement(folder: Path) -> Measurement:
    """Return the files that a measurement left in its folder."""
    notes = []
    for path in sorted((folder / "notes").glob("*.json")):
        try:
            note = json.loads(read_bytes(path, 64 * 1024, "a note"))
        except (ValueError, InputError):  # truncated because the process was killed
            continue
        if isinstance(note, dict):
            notes.append({key: str(value) for key, value in note.items()})
    measured = [note for note in notes if "problem" not in note and Path(note.get("executable", "")).is_file()]
    newest = max(measured, key=lambda note: _parse_version(note.get("python", "")), default=None)
    problems = [
        f"{note.get('executable') or 'a Python'} ({note.get('python')}) cannot be measured, neither with a coverage.py "
        f"of its own nor with ours: {shorten(one_line(note['problem']))}; install it there (pip install coverage)"
        for note in notes
        if "problem" in note
    ]
    files = []
    for path in sorted((folder / "data").glob(".coverage*")):
        try:
            measured_names([path])
            files.append(path)
        except InputError:
            problems.append(LOST_PROCESS)
    return Measurement(tuple(files), newest["executable"] if newest else None, tuple(problems))


class _Unittest:
    """Counter of tests in the output of unittest, over all of its runs."""

    def __init__(self) -> None:
        self._ran: int | None = None
        self._failed = self._skipped = 0

    def line(self, text: str) -> None:
        if found := _RAN_LINE.match(text):
            self._ran = (self._ran or 0) + int(found[1])
        elif self._ran is not None:
            if found := _SKIPPED_COUNT.match(text):
                self._skipped += int(found[1])
            if found := _FAILED_LINE.match(text):
                self._failed += sum(map(int, _FAILURE_COUNT.findall(found[1])))

    def tally(self) -> Tally | None:
        if self._ran is None:
            return None
        failed = min(self._failed, self._ran)
        return Tally(max(self._ran - failed - self._skipped, 0), failed, self._skipped)


def _with_multiprocessing(concurrency: object) -> list[str]:
    chosen = [str(name) for name in concurrency] if isinstance(concurrency, list) else []
    return list(dict.fromkeys([*(chosen or ["thread"]), "multiprocessing"]))


def _parse_version(text: str) -> tuple[int, ...]:
    return tuple(map(int, re.findall(r"[0-9]{1,6}", text)[:3]))


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
