"""Base class of the analysers, and their external programs: run without a shell, with a time limit and no secrets."""

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Category, CodeFinding, Severity
from calibration.base import InfrastructureError, one_line, shorten, temporary_folder

MAX_OUTPUT = 200_000_000
"""Limit of a program's output in bytes."""
MAX_MEMORY = 2 << 30
"""Limit of a program's memory in bytes, without what it reserves and never uses, which is a terabyte for shellcheck."""
_QUOTED_CODE = re.compile(r"^ *[0-9]* *\|", re.MULTILINE)


class ProgramFailedError(InfrastructureError):
    """A program ended with another exit code than expected, or by a signal."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.by_signal = code < 0


@dataclass(frozen=True)
class ProgramResult:
    """Exit code and output of a program."""

    code: int
    output: str
    errors: str


def program(name: str) -> str:
    """Return the path of a program from the packages of this Python, else of one on PATH.

    Raises:
        InfrastructureError: it is not installed.
    """
    beside = Path(sys.executable).with_name(name)
    found = str(beside) if os.access(beside, os.X_OK) else shutil.which(name)
    if found is None:
        raise InfrastructureError(f"{name} is not installed: pip install 'calibration-ci[analysis]', or by apt")
    return found


def module(name: str) -> list[str]:
    """Return the beginning of a command that runs a Python package, isolated from its working directory."""
    return [sys.executable, "-I", "-m", name]


def run_program(
    name: str, command: Sequence[str], folder: Path, seconds: float, codes: Collection[int]
) -> ProgramResult:
    """Run a program in a folder, and return its output.

    Args:
        name: of the analyser, for messages.
        command: the program and its arguments.
        folder: its working directory.
        seconds: time limit; at its end the whole process group is killed.
        codes: exit codes of success.

    Raises:
        ProgramFailedError: it fails.
        InfrastructureError: it cannot be started, takes too long, or prints too much.
    """
    with temporary_folder(prefix="calibration-analysis-") as home, tempfile.TemporaryFile() as output:
        own = {"HOME": str(home), "TMPDIR": str(home), "LC_ALL": "C.UTF-8"}
        environment = {"PATH": os.environ.get("PATH", os.defpath), **own}
        try:
            process = subprocess.Popen(
                command,
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            raise InfrastructureError(f"{name} cannot be started: {error.strerror}") from None
        if sys.platform == "linux":  # from here, as nothing may run between fork and exec beside other threads
            with suppress(ProcessLookupError):
                resource.prlimit(process.pid, resource.RLIMIT_DATA, (MAX_MEMORY, MAX_MEMORY))
        try:
            errors = process.communicate(timeout=seconds)[1].decode("utf-8", "replace")
        except subprocess.TimeoutExpired:
            raise InfrastructureError(
                f"{name} took longer than {seconds:g} s: name folders (paths) or more time"
            ) from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
        size = output.seek(0, os.SEEK_END)
        if process.returncode not in codes:
            raise failure_of(name, ProgramResult(process.returncode, "", errors))
        if size > MAX_OUTPUT:
            raise InfrastructureError(f"{name}: found {size} bytes of findings, expected at most {MAX_OUTPUT}")
        output.seek(0)
        return ProgramResult(process.returncode, output.read().decode("utf-8", "replace"), errors)


def json_output(name: str, result: ProgramResult) -> Any:
    """Parse what a program wrote as JSON.

    Raises:
        ProgramFailedError: it is none: without memory, shellcheck ends with the exit code of findings.
    """
    try:
        return json.loads(result.output)
    except ValueError:
        raise failure_of(name, result) from None


def failure_of(name: str, result: ProgramResult) -> ProgramFailedError:
    """Return the error of a program that failed, whatever its exit code."""
    message = f"{name} failed with exit code {result.code}: {_last_message(result.errors)}"
    return ProgramFailedError(message, result.code)


def _last_message(errors: str) -> str:
    """Return what a program says, up to the lines that it quotes: they may be of a file outside of the repository."""
    said = _QUOTED_CODE.split(errors, maxsplit=1)[0]
    return shorten(one_line(" ".join(said.split())), 400) or "it gave no reason"


class Analyser(ABC):
    """Analyser of files."""

    name: ClassVar[str]
    at_once: ClassVar[int] = 200
    """Limit of the number of files per process."""
    whole: ClassVar[bool] = False
    """Whether it compares files with each other, so that a change of one makes findings in others."""
    suffixes: ClassVar[tuple[str, ...]] = ()
    """Suffixes of its files, in small letters."""
    settings: ClassVar[tuple[str, ...]] = ()
    """Names of files with the team's settings for it."""

    def wants(self, path: str, copy: Copy) -> bool:
        """Whether it analyses a file: by default one of its suffixes."""
        return PurePosixPath(path).suffix.lower() in self.suffixes

    @abstractmethod
    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Analyse files.

        Args:
            copy: the folder of the files, with the team's settings.
            files: not empty, at most ``at_once``.
            seconds: time limit.

        Raises:
            InfrastructureError: the program is missing, fails or takes too long.
        """


def arguments(files: Sequence[str]) -> list[str]:
    """Return file names as arguments that are never parsed as options."""
    return [f"./{file}" for file in files]


ProgramFinding = tuple[str, int, str, Category, Severity, str]
"""Finding of a program: path as the program writes it, line, rule without the program's name, kind, and message."""


class ProgramAnalyser(Analyser):
    """Analyser that is an external program."""

    codes: ClassVar[tuple[int, ...]] = (0,)
    """Exit codes of success."""

    @abstractmethod
    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield commands, each with the files that are appended."""

    @abstractmethod
    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Yield the findings in the output of a command."""

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run the program, and convert its output."""
        found = []
        for command, paths in self.runs(copy, files):
            if paths:
                result = run_program(self.name, [*command, *arguments(paths)], copy.root, seconds, self.codes)
                for written, line, rule, category, severity, message in self.parsed(result):
                    path = written.removeprefix(f"{copy.root}/").removeprefix("./")
                    found.append(CodeFinding(path, max(line, 1), f"{self.name}/{rule}", category, severity, message))
        return found
