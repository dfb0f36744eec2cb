"""This process: its signals, its end, and its garbage collector; and the programs that it starts.

The runner cancels with SIGINT, then SIGTERM, then SIGKILL.

Exit code 1 always means the verdict, even if a library calls exit: OpenBLAS calls C's ``exit(1)`` if it finds no memory
for its buffers, which Python code cannot catch. So a handler of C's exit ends the process with 3 instead, and a command
that has returned ends the process without these handlers.
"""

import atexit
import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, Any, NoReturn

from calibration.base.errors import ExitCode

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SECONDS_BEFORE_REPEAT = 0.001
"""Delay in seconds after which a signal whose exception Python has dropped is raised again."""


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM. Subclass of KeyboardInterrupt, so that the same clean-up handles both."""


@contextmanager
def terminate_cleanly() -> Iterator[None]:
    """Turn SIGTERM into :class:`Terminated`, so that context managers and ``finally`` clauses run.

    After the first SIGINT or SIGTERM, SIGTERM is ignored: GitHub sends it while the clean-up
    after SIGINT is still running. A second SIGINT (by the user) interrupts again. Python drops an
    exception that is raised in a callback (of ``os.fork``, of the garbage collector): then the signal
    is raised again after the callback. Other code turns it into an exception of its own (numpy, while it is imported,
    into ImportError): then the signal's exception takes the place of that one. Does nothing outside the main thread,
    where Python handles no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    arrived: list[type[KeyboardInterrupt]] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        arrived.append(Terminated if number == signal.SIGTERM else KeyboardInterrupt)
        raise arrived[-1]

    def strike_again(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report_dropped(dropped)
            return
        number = signal.SIGTERM if issubclass(dropped.exc_type, Terminated) else signal.SIGINT
        signal.signal(signal.SIGALRM, lambda _number, frame: stop(number, frame))
        signal.setitimer(signal.ITIMER_REAL, _SECONDS_BEFORE_REPEAT)

    report_dropped, sys.unraisablehook = sys.unraisablehook, strike_again
    before = {number: signal.getsignal(number) for number in (*ENDING_SIGNALS, signal.SIGALRM)}
    signal.signal(signal.SIGTERM, stop)
    if before[signal.SIGINT] is not signal.SIG_IGN:  # ignored in a background job of a shell: keep that
        signal.signal(signal.SIGINT, stop)
    try:
        yield
    except Exception as error:
        if arrived:
            raise arrived[0] from error
        raise
    finally:
        sys.unraisablehook = report_dropped
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held_back() -> Iterator[None]:
    """Delay SIGINT and SIGTERM during a fork; they are raised at the end of the block.

    An exception during the fork would leave an untracked process, or be dropped by the
    callbacks of ``os.fork``. It uses handlers, not this thread's signal mask: Python handles a signal that another
    thread receives in the main thread too, and a new process would inherit the mask.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, lambda number, _frame: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])


def run_process(command: Callable[[], int]) -> NoReturn:
    """Run a command, and end the process with its exit code."""
    _mark_exits_of_libraries()
    _end_process(command())


def _mark_exits_of_libraries() -> None:
    """Make C's exit(), with any argument, end the process with the exit code of an infrastructure error.

    ``__cxa_atexit`` of the C++ ABI calls a function with an argument at exit: here ``_exit(3)``.
    """
    libc = ctypes.CDLL(None)
    with suppress(AttributeError):  # some C libraries lack it
        libc.__cxa_atexit(libc._exit, ctypes.c_void_p(int(ExitCode.INFRASTRUCTURE)), None)


def _end_process(code: int) -> NoReturn:
    """End the process as Python does (threads, exit handlers, streams), but without C's exit handlers."""
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads other than daemons
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


@contextmanager
def no_collector() -> Iterator[None]:
    """Disable the garbage collector while objects are made that stay: it would look through all of them repeatedly."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


STOP_SECONDS = 4.0
"""Seconds between SIGTERM and SIGKILL; a runner that cancels allows 7.5."""
_PR_SET_DUMPABLE = 4
_WATCHER_CODE = "import os, sys\nif not os.read(0, 1): os.killpg(int(sys.argv[1]), 9)"
"""Kills a process group when its standard input closes before anything was written to it."""


def hide(variables: Iterable[str]) -> None:
    """Remove variables from the environment, and protect this process from the programs that it starts.

    ``/proc/PID/environ`` shows the initial environment even after a variable is unset, so its memory is
    overwritten. On Linux no other process of this user can read this one's memory and open files from
    now on, except with CAP_SYS_PTRACE (root outside of a container). Parent processes are not changed.
    """
    libc = ctypes.CDLL(None)
    libc.getenv.restype = ctypes.c_void_p
    for name in variables:
        if address := libc.getenv(os.fsencode(name)):
            ctypes.memset(address, 0, len(ctypes.string_at(address)))
        os.environ.pop(name, None)
    if sys.platform == "linux":
        libc.prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)


@contextmanager
def started(
    arguments: Sequence[str],
    environment: Mapping[str, str],
    directory: Path | None = None,
    stdin: IO[bytes] | int = subprocess.DEVNULL,
) -> "Iterator[subprocess.Popen[bytes]]":
    """Run a program during the block; at its end the program has exited, and its process group is empty.

    The group is also killed if this process is killed and cannot clean up. Output and errors share one
    stream, to preserve the order of the lines.

    Raises:
        OSError, ValueError: it cannot be started.
    """
    process = watcher = None
    try:
        with held_back():
            process = subprocess.Popen(
                arguments,
                cwd=directory,
                env=environment,
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C reaches only this process, which stops the program
            )
            watcher = _start_watcher(process.pid)
        yield process
    finally:
        if process is not None:
            _end_group(process)
            if process.stdout is not None:
                process.stdout.close()
        if watcher is not None:
            watcher.communicate(b".")


def _start_watcher(group: int) -> "subprocess.Popen[bytes]":
    """Start a process that kills a process group if this process dies; any input ends it."""
    return subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _WATCHER_CODE, str(group)],
        env={},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def has_ended(process: "subprocess.Popen[bytes]", *, wait: bool = False) -> bool:
    """Return whether a process has ended, without reaping it: its pid stays reserved, so its group can be ended."""
    options = os.WEXITED | os.WNOWAIT | (0 if wait else os.WNOHANG)
    return os.waitid(os.P_PID, process.pid, options) is not None


def _end_group(process: "subprocess.Popen[bytes]") -> None:
    """End the process group: SIGTERM, then SIGKILL; SIGKILL at once if another signal interrupts this."""
    try:
        for number in (signal.SIGTERM, signal.SIGKILL):
            deadline = time.monotonic() + STOP_SECONDS
            if not _signal_group(process, number):
                break
            while time.monotonic() < deadline and _signal_group(process, 0):
                process.poll()  # reap it, otherwise it stays in its group as a zombie
                time.sleep(0.01)
    except BaseException:
        _signal_group(process, signal.SIGKILL)
        raise
    process.wait()


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> bool:
    """Send a signal to the group; return False if it is empty."""
    try:
        os.killpg(process.pid, number)
    except (ProcessLookupError, PermissionError):  # PermissionError: macOS, if only zombies are left in it
        return False
    return True
