"""Search for a ``docker`` command that supports BuildKit, and line-wise output of a program."""

import os
import re
import shutil
import subprocess
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import IO

from calibration.base.errors import InfrastructureError
from calibration.base.programs import has_ended, started

LONGEST_LINE = 64 * 1024


def lines_of(command: Sequence[str], stdin: IO[bytes], environment: Mapping[str, str]) -> Generator[str | int]:
    """Run a program; yield the lines of its output and errors, then its exit code.

    Closing the generator, or an exception while it waits, stops the program.

    Raises:
        InfrastructureError: the program cannot be started.
    """
    with ExitStack() as stack:
        try:
            process = stack.enter_context(started(command, environment, stdin=stdin))
        except OSError as error:
            raise InfrastructureError(f"{command[0]}: cannot be started: {error.strerror}") from error
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        while line := process.stdout.readline(LONGEST_LINE):
            yield line.decode("utf-8", "replace").rstrip("\r\n")
        has_ended(process, wait=True)
    yield process.returncode


VERSION_SECONDS = 20
"""Timeout of the commands that print a version."""
_VERSION_TEXT = re.compile(r"Docker version (\d+)\.(\d+)")


@dataclass(frozen=True)
class Program:
    """A ``docker`` command that supports BuildKit."""

    path: str
    buildx: bool
    """Whether BuildKit is available by the plugin buildx; otherwise it is built in (versions 18.09 to 22)."""


@cache
def find_buildkit(search_path: str) -> Program | None:
    """Find the first program on a PATH that supports BuildKit, preferably with buildx."""
    found = None
    for path in _find_programs(search_path):
        if _run_quietly(path, "buildx", "version") is not None:
            return Program(path, buildx=True)
        version = _VERSION_TEXT.search(_run_quietly(path, "--version") or "")
        if found is None and version and (18, 9) <= (int(version[1]), int(version[2])) < (23, 0):
            found = Program(path, buildx=False)
    return found


def docker_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables for a ``docker`` that builds only the image, without attestations and colours."""
    return {**environment, "DOCKER_BUILDKIT": "1", "BUILDX_NO_DEFAULT_ATTESTATIONS": "1", "NO_COLOR": "1"}


def _find_programs(search_path: str) -> Iterator[str]:
    folders = dict.fromkeys(filter(None, search_path.split(os.pathsep)))
    paths = (shutil.which("docker", path=folder) for folder in folders)
    return filter(None, paths)


def _run_quietly(*command: str) -> str | None:
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=VERSION_SECONDS,
            check=False,
            stdin=subprocess.DEVNULL,
            env=docker_environment(os.environ),
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
