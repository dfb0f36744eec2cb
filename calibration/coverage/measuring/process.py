"""A program of the team, followed live and ended with all that it has started."""

import os
import selectors
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from calibration.errors import InputError, WorldError
from calibration.programs import has_ended, started

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
            elif has_ended(process):  # what it has started may go on, and hold the output open
                break
            elif not more:
                time.sleep(_PAUSE)
    return process.returncode


@contextmanager
def _started(
    arguments: Sequence[str], directory: Path, environment: Mapping[str, str]
) -> "Iterator[subprocess.Popen[bytes]]":
    """A program that has ended when the block is left."""
    with ExitStack() as stack:
        try:
            process = stack.enter_context(started(arguments, environment, directory))
        except (OSError, ValueError) as error:
            raise InputError(f"run: {arguments[0]} cannot be started: {error}") from None
        yield process
