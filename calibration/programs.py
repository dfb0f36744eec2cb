"""Programs of others: started in a session of their own, ended with all that they have started."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from calibration.workflow.signals import held_back

GRACE = 4.0
"""Seconds to end after SIGTERM; a runner that cancels gives us 7.5."""


@contextmanager
def started(
    arguments: Sequence[str],
    environment: Mapping[str, str],
    directory: Path | None = None,
    stdin: IO[bytes] | int = subprocess.DEVNULL,
) -> "Iterator[subprocess.Popen[bytes]]":
    """A program that has ended, with its process group, when the block is left; then it has its exit code.

    Its output and its errors are one stream, so that the order of the lines stays.

    Raises:
        OSError, ValueError: it cannot be started.
    """
    process = None
    try:
        with held_back():
            process = subprocess.Popen(
                arguments,
                cwd=directory,
                env=environment,
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C reaches us alone, and we stop it
            )
        yield process
    finally:
        if process is not None:
            _end(process)
            if process.stdout is not None:
                process.stdout.close()


def has_ended(process: "subprocess.Popen[bytes]", *, wait: bool = False) -> bool:
    """Whether it has ended; its number stays taken until it is waited for, so that its group can be ended."""
    options = os.WEXITED | os.WNOWAIT | (0 if wait else os.WNOHANG)
    return os.waitid(os.P_PID, process.pid, options) is not None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End the process group: asked first, then killed; killed at once where another signal interrupts this."""
    try:
        for number in (signal.SIGTERM, signal.SIGKILL):
            deadline = time.monotonic() + GRACE
            if not _signal_group(process, number):
                break
            while time.monotonic() < deadline and _signal_group(process, 0):
                process.poll()  # or it would stay in its group when it has ended
                time.sleep(0.01)
    except BaseException:
        _signal_group(process, signal.SIGKILL)
        raise
    process.wait()


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> bool:
    """Send a signal to the group; whether there was anyone in it."""
    try:
        os.killpg(process.pid, number)
    except (ProcessLookupError, PermissionError):  # the latter where macOS has only zombies in it
        return False
    return True
