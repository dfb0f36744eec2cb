"""The end of a process: an exit code of 1 is a verdict, whoever calls exit.

OpenBLAS that finds no memory for its buffers calls C's ``exit(1)``, which no Python code can catch. So a handler of C's
exit ends the process with 3 instead, and a command that has returned ends the process without these handlers.
"""

import atexit
import ctypes
import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from calibration.errors import ExitCode


def run_process(command: Callable[[], int]) -> NoReturn:
    """Run a command as all that this process does, and end the process with its exit code."""
    _mark_exits_of_libraries()
    _end(command())


def _mark_exits_of_libraries() -> None:
    """Make C's exit(), whatever its argument, end the process with the code of an infrastructure failure.

    ``__cxa_atexit`` of the C++ ABI calls a function with an argument at exit: here ``_exit(3)``.
    """
    libc = ctypes.CDLL(None)
    with suppress(AttributeError):  # a C library without it: then there is no handler
        libc.__cxa_atexit(libc._exit, ctypes.c_void_p(int(ExitCode.INFRASTRUCTURE)), None)


def _end(code: int) -> NoReturn:
    """End as Python does (threads, exit handlers, streams), but without C's exit handlers."""
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads that are no daemons
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
