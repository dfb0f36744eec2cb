"""A program of the team, followed live and ended with all that it has started."""

import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from calibration.errors import InputError, WorldError

GRACE = 4.0
"""Seconds to end after SIGTERM; a runner that cancels gives us 7.5."""
_PAUSE = 0.1


def run(
    arguments: Sequence[str],
    directory: Path,
    environment: Mapping[str, str],
    seconds: float,
    feed: Callable[[bytes], None],
) -> int:
    """Run a program, and return its exit code (below 0: of the signal that killed it).

    Whatever it leaves running in its process group is ended too, then and when this is interrupted.

    Args:
        arguments: the program first.
        directory: that it runs in.
        environment: all its variables.
        seconds: that it may take.
        feed: is given its output and its errors as they come.

    Raises:
        InputError: it cannot be started.
        WorldError: it takes longer.
    """
    deadline = time.monotonic() + seconds
    with _started(arguments, directory, environment) as process, selectors.DefaultSelector() as selector:
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        selector.register(process.stdout, selectors.EVENT_READ)
        more = True
        while True:
            if time.monotonic() > deadline:
                raise WorldError(f"the tests took longer than {seconds:g} s (timeout) and were stopped")
            if more and selector.select(_PAUSE):
                data = os.read(process.stdout.fileno(), 64 * 1024)
                feed(data)
                more = bool(data)
            elif _has_ended(process):  # what it has started may go on, and hold the output open
                break
            elif not more:
                time.sleep(_PAUSE)
    return process.returncode


@contextmanager
def _started(
    arguments: Sequence[str], directory: Path, environment: Mapping[str, str]
) -> "Iterator[subprocess.Popen[bytes]]":
    """A program that has ended when the block is left."""
    # Held back until we can answer them: one that arrived while the program starts would leave it behind.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    process = None
    try:
        process = _start(arguments, directory, environment, mask)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        yield process
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if process is not None:
            _end(process)
            if process.stdout is not None:
                process.stdout.close()


def _start(
    arguments: Sequence[str], directory: Path, environment: Mapping[str, str], mask: Iterable[int]
) -> "subprocess.Popen[bytes]":
    try:
        return subprocess.Popen(
            arguments,
            cwd=directory,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,  # one stream: the order of the lines stays
            start_new_session=True,
            preexec_fn=lambda: signal.pthread_sigmask(signal.SIG_SETMASK, mask),
        )
    except (OSError, ValueError) as error:
        raise InputError(f"run: {arguments[0]} cannot be started: {error}") from None


def _has_ended(process: "subprocess.Popen[bytes]") -> bool:
    """Whether it has ended; its number stays taken until it is waited for, so that its group can be ended."""
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End the process group: asked first, then killed."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        deadline = time.monotonic() + GRACE
        if not _signal_group(process, number):
            break
        while time.monotonic() < deadline and _signal_group(process, 0):
            process.poll()  # or it would stay in its group when it has ended
            time.sleep(0.01)
    process.wait()


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> bool:
    """Send a signal to the group; whether there was anyone in it."""
    try:
        os.killpg(process.pid, number)
    except (ProcessLookupError, PermissionError):  # the latter where macOS has only zombies in it
        return False
    return True
