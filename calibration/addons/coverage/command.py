"""The user's test command as a program with arguments. It is not run by a shell."""

import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from calibration.addons.coverage.injection import plain
from calibration.base.errors import InputError

_PYTEST_NAMES = ("pytest", "py.test")
_PYTHON_NAMES = ("python3", "python")
_JUNIT_OPTIONS = ("--junitxml", "--junit-xml")


@dataclass(frozen=True)
class CommandOfTests:
    """A program to run."""

    text: str
    """The command as the user wrote it."""
    arguments: tuple[str, ...]
    junit: Path | None = None
    """File that the program writes its results to as JUnit XML; None if it writes none."""


def parse_command(
    text: str, directory: Path, interpreter: str | None, environment: dict[str, str], junit: Path
) -> CommandOfTests:
    """Parse a test command: a program, ``unittest ...``, or a folder of tests.

    Args:
        text: as the user wrote it.
        directory: working directory of the command.
        interpreter: the Python to use; None for the one that the command finds on the ``PATH``.
        environment: environment variables of the command.
        junit: file for pytest's results, unless the command names one.

    Raises:
        InputError: it is empty, or the program does not exist.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"run: {text!r} cannot be split into arguments: {error}") from None
    if not words:
        raise InputError(
            "run is empty: a command such as pytest, python -m unittest, or a folder of tests was expected"
        )
    path = environment.get("PATH")
    python = _find_python(interpreter, path)
    if len(words) == 1 and (directory / words[0]).is_dir():
        words = [*_runner_of_folder(python, environment, directory), words[0]]
    words = _with_interpreter(words, directory, python, interpreter, path)
    found = shutil.which(words[0], path=path) if "/" not in words[0] else words[0]
    if found is None or not (directory / found).is_file():
        raise InputError(
            f"run: there is no program {words[0]!r} (the command is not run by a shell: && and | have no effect)"
        )
    return CommandOfTests(text, *_with_junit(words, directory, junit))


def _find_python(interpreter: str | None, path: str | None) -> str | None:
    """Return the path of the requested interpreter, or of the first Python on the PATH; None without one.

    Raises:
        InputError: the requested interpreter does not exist.
    """
    for name in (interpreter,) if interpreter else _PYTHON_NAMES:
        if (found := shutil.which(name, path=path)) is not None:
            return str(Path(found).absolute())
    if interpreter:
        raise InputError(f"interpreter: {interpreter!r} is not a program; the path of a Python was expected")
    return None


def _with_interpreter(
    words: list[str], directory: Path, python: str | None, interpreter: str | None, path: str | None
) -> list[str]:
    program, *rest = words
    if program == python:
        return words
    if program == "unittest":
        return [_require_python(python), "-m", "unittest", *_unittest_arguments(rest, directory)]
    if program in _PYTHON_NAMES and (interpreter or shutil.which(program, path=path) is None):
        return [_require_python(python), *rest]
    if program in _PYTEST_NAMES and (interpreter or shutil.which(program, path=path) is None):
        return [_require_python(python), "-m", "pytest", *rest]
    if interpreter and program not in (*_PYTHON_NAMES, *_PYTEST_NAMES):
        raise InputError(f"interpreter is given, but {program!r} uses its own: a command such as pytest was expected")
    return words


def _require_python(python: str | None) -> str:
    if python is None:
        raise InputError("run: there is no python3 on the PATH: install one before this step, or set interpreter")
    return python


def _runner_of_folder(python: str | None, environment: dict[str, str], directory: Path) -> list[str]:
    """Return pytest if it is installed in the interpreter, else unittest."""
    python = _require_python(python)
    try:
        has_pytest = not subprocess.run(
            [python, "-c", "import pytest"],
            cwd=directory,
            env=plain(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=60,
            check=False,
        ).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"interpreter: {python} does not run: {error}") from None
    return [python, "-m", "pytest"] if has_pytest else ["unittest"]


def _unittest_arguments(arguments: Sequence[str], directory: Path) -> list[str]:
    """Return the arguments with which unittest discovers the tests of a folder (start and top-level folder)."""
    if len(arguments) != 1 or not (directory / arguments[0]).is_dir():
        return list(arguments)
    top = folder = Path(arguments[0])
    while (directory / top / "__init__.py").is_file() and top != top.parent:
        top = top.parent
    return ["discover", "-s", str(folder), *(["-t", str(top)] if top != folder else [])]


def _with_junit(words: list[str], directory: Path, junit: Path) -> tuple[tuple[str, ...], Path | None]:
    """Add options for JUnit XML if the command obviously runs pytest."""
    runs_pytest = Path(words[0]).name in _PYTEST_NAMES or any(
        first in ("-m", "run") and second in _PYTEST_NAMES for first, second in pairwise(words)
    )
    if not runs_pytest:
        return tuple(words), None
    for word, following in zip(words, [*words[1:], ""], strict=True):
        option, _, value = word.partition("=")
        if option in _JUNIT_OPTIONS and (value or following):
            return tuple(words), directory / (value or following)
    return (*words, f"--junitxml={junit}", "--override-ini=junit_family=xunit1"), junit
