"""Processes of the team's tests that run chosen tests again and again, each in its own copy of the checkout.

A process collects the tests once and forks for each job (``injected/calibration_pseudo_tested.py``). What it tells is
untrusted, as it runs the tests.
"""

import json
import os
import select
import selectors
import shutil
import signal
import socket
import stat
import subprocess
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from calibration.base import InfrastructureError, InputError, one_line, shorten
from calibration.base.process import has_ended, started

MAX_COPY_BYTES = 2 << 30
"""Largest checkout that is copied."""
MAX_MESSAGE_BYTES = 64 << 20
"""Largest message of a process of the tests: the names of all tests."""
SECONDS_BETWEEN_POLLS = 0.05
SECONDS_TO_END_JOB = 2.0
SECONDS_TO_COLLECT = 120.0
"""How long the tests may take to be imported while a function is replaced that is run then."""
CACHE_FOLDERS = (".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis")
"""Folders that are left out of a copy."""
LINKED_FOLDERS = ("node_modules",)
"""Folders that a copy links to, beside environments of Python."""


@dataclass(frozen=True)
class Replacement:
    """What takes the place of a function's body."""

    value: str = "None"
    """Python expression of what is returned, or yielded once by a generator."""
    argument: int | None = None
    """Position of the argument that is returned instead."""
    nothing: bool = False
    """Whether a generator yields nothing."""
    fields: tuple[str, ...] = ()
    """Attributes of its first argument that get a value where they have none."""
    field: str = "None"
    """Python expression of that value."""


@dataclass(frozen=True)
class TestJob:
    """Tests to run with at most one function replaced."""

    __test__ = False  # keeps pytest from collecting it

    tests: tuple[str, ...]
    seconds: float
    function: int | None = None
    replacement: Replacement | None = None
    record: Path | None = None
    """File for the record of which test runs which function."""
    from_start: bool = False
    """Whether this holds already while the tests are imported."""

    @property
    def document(self) -> dict[str, Any]:
        """What it tells the process of the tests."""
        if self.record is not None:
            return {"record": str(self.record)}
        if self.function is None or self.replacement is None:
            return {}
        return {"function": self.function, "replacement": asdict(self.replacement)}

    @property
    def preset(self) -> dict[str, Any]:
        """What a process begins with that can run it."""
        return self.document if self.from_start else {}


@dataclass(frozen=True)
class JobOutcome:
    """What came of a job."""

    passed: bool
    test: str | None = None
    """The test that failed; None also if the process crashed or took too long."""


Judging = Generator[TestJob, JobOutcome, None]
"""A task: decides on jobs by the outcomes of those before."""


class TestWorker:
    """A process of the tests, which runs one job after the other."""

    __test__ = False  # keeps pytest from collecting it

    def __init__(
        self,
        arguments: Sequence[str],
        directory: Path,
        environment: Mapping[str, str],
        address: Path,
        selector: selectors.BaseSelector,
        feed: Callable[[bytes], None],
    ) -> None:
        """Prepare it; the process starts with its first job.

        Args:
            arguments: the command of the tests.
            directory: where it runs, in a copy of the checkout.
            environment: all environment variables.
            address: socket at which the process asks for jobs.
            selector: of `run_on`: what to call when something arrives.
            feed: called with the output of the tests.
        """
        self.tests: tuple[str, ...] = ()
        """Names of all tests, once they are collected."""
        self.task: Judging | None = None
        self._arguments, self._directory, self._environment = arguments, directory, environment
        self._address, self._selector, self._feed = address, selector, feed
        self._stack = ExitStack()
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._preset: dict[str, Any] = {}
        self._job: TestJob | None = None
        self._sent = False
        self._child: int | None = None
        self._failed: str | None = None
        self._deadline = 0.0
        self._received = b""
        self._last_output = b""

    def prepare(self) -> None:
        """Start the process before there is a job, so that it collects the tests meanwhile."""
        self._start({})

    def begin(self, task: Judging) -> None:
        """Begin with a task."""
        self.task = task
        self._advance(None)

    def check(self) -> None:
        """End a job that takes too long, and notice the end of the process.

        Raises:
            InputError: it has ended, and no function was replaced that may have caused it.
        """
        if self._child is not None and time.monotonic() > self._deadline:
            self._kill_child()
            self._deadline = time.monotonic() + 1
        if self._process is None or self._connection is not None:
            return
        stuck = "function" in self._preset and time.monotonic() > self._deadline
        if stuck or has_ended(self._process):
            self._lose()

    def finish(self, seconds: float) -> None:
        """Let the command come to its end, and see that it runs no further tests.

        Raises:
            InputError: it does.
        """
        if self._connection is None or self._process is None:
            return
        self._selector.unregister(self._connection)
        self._connection.shutdown(socket.SHUT_WR)
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not has_ended(self._process):
            _handle_events(self._selector)

    def close(self) -> None:
        """End the process, and all that its jobs have started."""
        process = self._process
        if process is None:
            return
        task, self.task = self.task, None  # what is still read goes on with nothing
        try:
            with suppress(OSError, InputError):
                self._end_job()
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
        finally:
            self.task, self._process, self._connection, self._child = task, None, None, None
            stack, self._stack = self._stack, ExitStack()
            stack.close()

    def _end_job(self) -> None:
        """Kill the job, and wait until its process has ended what the job has left behind."""
        deadline = time.monotonic() + SECONDS_TO_END_JOB
        while self._sent and self._connection is not None and time.monotonic() < deadline:
            self._kill_child()
            select.select([self._connection], [], [], SECONDS_BETWEEN_POLLS)
            self._read_messages(self._connection)

    def _start(self, preset: dict[str, Any]) -> None:
        self.close()
        self._preset, self._sent, self._received, self._failed = preset, False, b"", None
        self._address.unlink(missing_ok=True)
        listener = self._stack.enter_context(socket.socket(socket.AF_UNIX))
        listener.bind(str(self._address))
        listener.listen(1)
        environment = {**self._environment, "CALIBRATION_PSEUDO_JOB": json.dumps(preset)}
        try:
            process = self._stack.enter_context(started(self._arguments, environment, self._directory))
        except (OSError, ValueError) as error:
            raise InputError(f"tests: {self._arguments[0]} cannot be started: {error}") from None
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        output = process.stdout
        os.set_blocking(output.fileno(), False)
        self._process = process
        self._deadline = time.monotonic() + SECONDS_TO_COLLECT
        self._watch(listener, lambda: self._accept(listener))
        self._watch(output, lambda: self._read_output(output))

    def _watch(self, source: Any, call: Callable[[], object]) -> None:
        self._selector.register(source, selectors.EVENT_READ, call)
        self._stack.callback(lambda: source in self._selector.get_map() and self._selector.unregister(source))

    def _accept(self, listener: socket.socket) -> None:
        connection = self._stack.enter_context(listener.accept()[0])
        if self._connection is not None:
            raise InputError(
                "pseudo-tested: run starts pytest or unittest more than once: it can only judge one run of them"
            )
        self._connection = connection
        self._watch(connection, lambda: self._read_messages(connection))

    def _read_output(self, output: IO[bytes]) -> None:
        """Pass on what has arrived, without waiting."""
        with suppress(BlockingIOError):
            while data := os.read(output.fileno(), 1 << 16):
                self._feed(data)
                self._last_output = (self._last_output + data)[-2000:]
            self._selector.unregister(output)

    def _read_messages(self, connection: socket.socket) -> bool:
        """Handle what has arrived; return whether there may be more."""
        try:
            data = connection.recv(1 << 20, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except ConnectionError:
            data = b""
        if not data:
            if self._connection is connection:
                self._lose()
            return False
        *lines, self._received = (self._received + data).split(b"\n")
        if len(self._received) > MAX_MESSAGE_BYTES:
            raise InputError("pseudo-tested: the names of the tests are longer than 64 MiB")
        for line in lines:
            self._handle(line)
        return True

    def _handle(self, line: bytes) -> None:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            message = None
        match message:
            case {"tests": list() as tests}:
                self.tests = tuple(map(str, tests))
                self._send()
            case {"child": int() as child}:
                self._child = child
            case {"failed": str() as test}:
                self._failed = test
            case {"ended": bool() as passed} if self._sent:
                self._child, self._sent, self._job = None, False, None
                self._advance(JobOutcome(passed, self._failed))
            case _:
                raise InputError("pseudo-tested: a process of the tests told something else than what came of its job")

    def _advance(self, outcome: JobOutcome | None) -> None:
        """Go on with the task by its next job."""
        if self.task is None:
            return
        try:
            self._job = next(self.task) if outcome is None else self.task.send(outcome)
        except StopIteration:
            self.task = None
            return
        preset = self._job.preset
        if self._process is None or (self._preset != preset and (preset or "record" not in self._preset)):
            self._start(preset)
        else:
            self._send()

    def _send(self) -> None:
        if self._connection is None or self._job is None or self._sent:
            return
        self._failed, self._sent = None, True
        self._deadline = time.monotonic() + self._job.seconds
        document = {**self._job.document, "tests": self._job.tests or self.tests}
        self._connection.sendall(json.dumps(document).encode() + b"\n")

    def _lose(self) -> None:
        """Go on after the end of the process, which only a replaced function may cause.

        Raises:
            InputError: nothing was replaced.
        """
        process, connected = self._process, self._connection is not None
        self._connection = None
        if process is None:
            return
        if process.stdout is not None and process.stdout in self._selector.get_map():
            self._read_output(process.stdout)
        self.close()
        if "function" in self._preset:
            self._advance(JobOutcome(passed=False))
            return
        last = one_line(self._last_output.decode("utf-8", "replace").strip().rpartition("\n")[2])
        if connected or process.returncode:
            raise InputError(
                f"pseudo-tested: the tests cannot be run in a copy of the checkout: exit code {process.returncode}"
                f"{f', {shorten(last, 200)}' if last else ''}"
            )
        raise InputError(
            "pseudo-tested: run starts no pytest and no unittest, of a Python >= 3.8 that heeds PYTHONPATH: "
            "leave pseudo-tested out, or set run to such a command"
        )

    def _kill_child(self) -> None:
        if self._child is not None and self._process is not None and _session_of(self._child) == self._process.pid:
            with suppress(OSError):
                os.killpg(self._child, signal.SIGKILL)


def _session_of(process: int) -> int | None:
    """Return the session of a process; None if there is no such process."""
    try:
        return os.getsid(process) if process > 1 else None
    except OSError:
        return None


def _handle_events(selector: selectors.BaseSelector) -> None:
    """Call what waits for what arrives within a moment."""
    for key, _ in selector.select(SECONDS_BETWEEN_POLLS):
        if selector.get_map().get(key.fd) == key:  # not closed by what was called before
            key.data()


def run_on(
    workers: Sequence[TestWorker], tasks: Iterable[Judging], deadline: float, selector: selectors.BaseSelector
) -> bool:
    """Run tasks on workers, each worker one task at a time; return whether all are done before time is up."""
    waiting = deque(tasks)
    while time.monotonic() < deadline:
        for worker in workers:
            if worker.task is None and waiting:
                worker.begin(waiting.popleft())
        if not waiting and all(worker.task is None for worker in workers):
            return True
        _handle_events(selector)
        for worker in workers:
            worker.check()
    return False


def copy_of_checkout(root: Path, copy: Path, without: Path | None) -> None:
    """Copy a checkout with all that lies in it: builds and generated files too, as the tests may need them.

    Environments of Python and Node are linked to. Links stay links.

    Args:
        root: the checkout.
        copy: the folder to create.
        without: a folder that is left out: of results.

    Raises:
        InputError: it is larger than `MAX_COPY_BYTES`.
        InfrastructureError: it cannot be copied.
    """
    size = 0

    def copy_file(source: str, target: str) -> None:
        nonlocal size
        status = os.lstat(source)
        size += status.st_size
        if size > MAX_COPY_BYTES:
            raise InputError(f"pseudo-tested: {root} has more than {MAX_COPY_BYTES >> 30} GiB, the most that is copied")
        if stat.S_ISREG(status.st_mode) or stat.S_ISLNK(status.st_mode):
            shutil.copy2(source, target, follow_symlinks=False)

    def left_out(folder: str, names: list[str]) -> list[str]:
        found = []
        for name in names:
            path = Path(folder, name)
            linked = name in LINKED_FOLDERS or (path / "pyvenv.cfg").is_file()
            if linked and path.is_dir():
                target = copy / path.relative_to(root)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.symlink_to(path)
            of_git_elsewhere = name == ".git" and path.is_file()
            if linked or of_git_elsewhere or name in CACHE_FOLDERS or path == without:
                found.append(name)
        return found

    try:
        shutil.copytree(root, copy, symlinks=True, ignore=left_out, copy_function=copy_file, dirs_exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise InfrastructureError(
            f"pseudo-tested: {root} cannot be copied: {shorten(one_line(str(error)), 300)}"
        ) from None
