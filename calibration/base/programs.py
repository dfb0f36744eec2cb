"""External programs: each started in its own session, ended with its whole process group, without our secrets."""

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

from calibration.base.process import held_back

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
