"""A program of others, and what it prints, line by line; stopped with all that it has started."""

import os
import signal
import subprocess
from collections.abc import Generator, Mapping, Sequence
from typing import IO

from calibration.errors import WorldError

GRACE = 4.0
"""Seconds to end after SIGTERM; a runner that cancels gives us 7.5."""
LONGEST_LINE = 64 * 1024


def lines_of(command: Sequence[str], stdin: IO[bytes], environment: Mapping[str, str]) -> Generator[str | int]:
    """Run a program; yields the lines of its output and errors, and at the end its exit code.

    Closing the generator, or an exception while it waits, stops the program.

    Raises:
        WorldError: it cannot be started.
    """
    try:
        process = subprocess.Popen(
            command,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,  # a Ctrl-C reaches us alone, and we stop it
        )
    except OSError as error:
        raise WorldError(f"{command[0]}: cannot be started: {error.strerror}") from error
    output = process.stdout
    if output is None:
        raise AssertionError("its output is a pipe")
    try:
        while line := output.readline(LONGEST_LINE):
            yield line.decode("utf-8", "replace").rstrip("\r\n")
        yield process.wait()
    finally:
        _stop(process)
        output.close()


def _stop(process: "subprocess.Popen[bytes]") -> None:
    for number, seconds in ((signal.SIGTERM, GRACE), (signal.SIGKILL, None)):
        if process.poll() is not None:
            return
        os.killpg(process.pid, number)
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            continue
