"""End of a process, so that exit code 1 always means the verdict, even if a library calls exit.

OpenBLAS calls C's ``exit(1)`` if it finds no memory for its buffers, which Python code cannot catch. So a handler of
C's exit ends the process with 3 instead, and a command that has returned ends the process without these handlers.
"""

import atexit
import ctypes
import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from calibration.base.errors import ExitCode


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
