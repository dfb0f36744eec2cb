"""Programs of others: started in a session of their own, ended with all that they have started, told no secrets."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from calibration.workflow.signals import held_back

GRACE = 4.0
"""Seconds to end after SIGTERM; a runner that cancels gives us 7.5."""
_PR_SET_DUMPABLE = 4
_WATCHER = "import os, sys\nif not os.read(0, 1): os.killpg(int(sys.argv[1]), 9)"
"""Kills a process group when its standard input closes and nothing was written there."""


def hide(variables: Iterable[str]) -> None:
    """Take variables out of the environment, and close this process to the programs that it starts.

    What a process was started with stays readable in ``/proc/PID/environ`` after a variable is unset: so it is
    overwritten where it lies. On Linux no other process of this user may read this one's memory and open files from
    now on, except with CAP_SYS_PTRACE (root outside of a container). Processes above this one are not touched.
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
    """A program that has ended, with its process group, when the block is left; then it has its exit code.

    The group is killed too when this process is killed and can clean up nothing. Its output and its errors are one
    stream, so that the order of the lines stays.

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
                start_new_session=True,  # a Ctrl-C reaches us alone, and we stop it
            )
            watcher = _watcher(process.pid)
        yield process
    finally:
        if process is not None:
            _end(process)
            if process.stdout is not None:
                process.stdout.close()
        if watcher is not None:
            watcher.communicate(b".")


def _watcher(group: int) -> "subprocess.Popen[bytes]":
    """A process that outlives this one if it is killed, to kill a process group then; any input ends it."""
    return subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _WATCHER, str(group)],
        env={},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


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
