"""A program of others, and what it prints, line by line; stopped with all that it has started."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from typing import IO

from calibration.errors import WorldError
from calibration.programs import has_ended, started

LONGEST_LINE = 64 * 1024


def lines_of(command: Sequence[str], stdin: IO[bytes], environment: Mapping[str, str]) -> Generator[str | int]:
    """Run a program; yields the lines of its output and errors, and at the end its exit code.

    Closing the generator, or an exception while it waits, stops the program.

    Raises:
        WorldError: it cannot be started.
    """
    with ExitStack() as stack:
        try:
            process = stack.enter_context(started(command, environment, stdin=stdin))
        except OSError as error:
            raise WorldError(f"{command[0]}: cannot be started: {error.strerror}") from error
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        while line := process.stdout.readline(LONGEST_LINE):
            yield line.decode("utf-8", "replace").rstrip("\r\n")
        has_ended(process, wait=True)
    yield process.returncode
