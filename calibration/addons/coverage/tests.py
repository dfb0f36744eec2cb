"""The team's test command, which no shell runs, and its run with measurement; the verdict follows from its outcome."""

import json
import os
import re
import selectors
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from calibration.addons.coverage.coverage_py import bring_coverage, measured_names, measuring, plain, write_settings
from calibration.addons.coverage.formats import MAX_BYTES
from calibration.base import InfrastructureError, InputError, one_line, read_bytes, shorten
from calibration.base.process import has_ended, started
from calibration.base.records import computed, field, result
from calibration.ci.report.junit import Tally, read_test_report
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.streams import LogDisplay, LogFile

_PYTEST_NAMES = ("pytest", "py.test")
_PYTHON_NAMES = ("python3", "python")
_JUNIT_OPTIONS = ("--junitxml", "--junit-xml")


@dataclass(frozen=True)
class CommandOfTests:
    """A program to run."""

    text: str
    """The command as the user wrote it."""
    arguments: tuple[str, ...]
    junit: Path | None = None
    """File that the program writes its results to as JUnit XML; None if it writes none."""


def parse_command(
    text: str, directory: Path, interpreter: str | None, environment: dict[str, str], junit: Path
) -> CommandOfTests:
    """Parse a test command: a program, ``unittest ...``, or a folder of tests.

    Args:
        text: as the user wrote it.
        directory: working directory of the command.
        interpreter: the Python to use; None for the one that the command finds on the ``PATH``.
        environment: environment variables of the command.
        junit: file for pytest's results, unless the command names one.

    Raises:
        InputError: it is empty, or the program does not exist.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"tests: {text!r} cannot be split into arguments: {error}") from None
    if not words:
        raise InputError(
            "tests is empty: a command such as pytest, python -m unittest, or a folder of tests was expected"
        )
    path = environment.get("PATH")
    python = _find_python(interpreter, path)
    if len(words) == 1 and (directory / words[0]).is_dir():
        words = [*_runner_of_folder(python, environment, directory), words[0]]
    words = _with_interpreter(words, directory, python, interpreter, path)
    found = shutil.which(words[0], path=path) if "/" not in words[0] else words[0]
    if found is None or not (directory / found).is_file():
        raise InputError(
            f"tests: there is no program {words[0]!r} (the command is not run by a shell: && and | have no effect)"
        )
    return CommandOfTests(text, *_with_junit(words, directory, junit))


def _find_python(interpreter: str | None, path: str | None) -> str | None:
    """Return the path of the requested interpreter, or of the first Python on the PATH; None without one.

    Raises:
        InputError: the requested interpreter does not exist.
    """
    for name in (interpreter,) if interpreter else _PYTHON_NAMES:
        if (found := shutil.which(name, path=path)) is not None:
            return str(Path(found).absolute())
    if interpreter:
        raise InputError(f"interpreter: {interpreter!r} is not a program; the path of a Python was expected")
    return None


def _with_interpreter(
    words: list[str], directory: Path, python: str | None, interpreter: str | None, path: str | None
) -> list[str]:
    program, *rest = words
    if program == python:
        return words
    if program == "unittest":
        return [_require_python(python), "-m", "unittest", *_unittest_arguments(rest, directory)]
    if program in _PYTHON_NAMES and (interpreter or shutil.which(program, path=path) is None):
        return [_require_python(python), *rest]
    if program in _PYTEST_NAMES and (interpreter or shutil.which(program, path=path) is None):
        return [_require_python(python), "-m", "pytest", *rest]
    if interpreter and program not in (*_PYTHON_NAMES, *_PYTEST_NAMES):
        raise InputError(f"interpreter is given, but {program!r} uses its own: a command such as pytest was expected")
    return words


def _require_python(python: str | None) -> str:
    if python is None:
        raise InputError("tests: there is no python3 on the PATH: install one before this step, or set interpreter")
    return python


def _runner_of_folder(python: str | None, environment: dict[str, str], directory: Path) -> list[str]:
    """Return pytest if it is installed in the interpreter, else unittest."""
    python = _require_python(python)
    try:
        has_pytest = not subprocess.run(
            [python, "-c", "import pytest"],
            cwd=directory,
            env=plain(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=60,
            check=False,
        ).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"interpreter: {python} does not run: {error}") from None
    return [python, "-m", "pytest"] if has_pytest else ["unittest"]


def _unittest_arguments(arguments: Sequence[str], directory: Path) -> list[str]:
    """Return the arguments with which unittest discovers the tests of a folder (start and top-level folder)."""
    if len(arguments) != 1 or not (directory / arguments[0]).is_dir():
        return list(arguments)
    top = folder = Path(arguments[0])
    while (directory / top / "__init__.py").is_file() and top != top.parent:
        top = top.parent
    return ["discover", "-s", str(folder), *(["-t", str(top)] if top != folder else [])]


def _with_junit(words: list[str], directory: Path, junit: Path) -> tuple[tuple[str, ...], Path | None]:
    """Add options for JUnit XML if the command obviously runs pytest."""
    runs_pytest = Path(words[0]).name in _PYTEST_NAMES or any(
        first in ("-m", "run") and second in _PYTEST_NAMES for first, second in pairwise(words)
    )
    if not runs_pytest:
        return tuple(words), None
    for word, following in zip(words, [*words[1:], ""], strict=True):
        option, _, value = word.partition("=")
        if option in _JUNIT_OPTIONS and (value or following):
            return tuple(words), directory / (value or following)
    return (*words, f"--junitxml={junit}", "--override-ini=junit_family=xunit1"), junit


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
            raise InputError(f"tests: {arguments[0]} cannot be started: {error}") from None
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
