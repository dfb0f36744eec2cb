"""Errors shown to users, in one line each, with their exit codes."""

import enum
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

LONGEST_MESSAGE = 2000
_LONG_WORD = r"([^\s/]{60})[^\s/]{180,}([^\s/]{16})"
"""A word longer than any file name."""


def brief(message: str) -> str:
    """Shorten a message: cut the middle of long words, and of the message if it is still too long."""
    message = re.sub(_LONG_WORD, r"\1…\2", message)
    end = LONGEST_MESSAGE // 4
    return message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - end]}…{message[-end:]}"


class ExitCode(enum.IntEnum):
    """Exit codes of all commands."""

    PASS = 0
    """The verdict is pass, or there is no verdict and the work is done."""
    FAIL = 1
    """The verdict is fail."""
    BAD_INPUT = 2
    """An input, a configuration or a data file is wrong."""
    INFRASTRUCTURE = 3
    """Infrastructure failed: engine, network, disk, timeout."""


def exit_code_of(passed: bool, errors: Iterable[ExitCode | None]) -> ExitCode:
    """Return the highest code of the errors (2 or 3) if there are any, else that of the verdict."""
    return max((error for error in errors if error is not None), default=ExitCode.PASS if passed else ExitCode.FAIL)


class CalibrationError(Exception):
    """Base class of errors whose message is shown to the user: one line with where, what was found, what to do.

    Messages may quote untrusted text: non-printable characters, including line ends, are escaped, long parts are cut.
    """

    exit_code: ExitCode = ExitCode.INFRASTRUCTURE

    def __init__(self, message: str) -> None:
        message = brief(message)
        if not message.isprintable():
            message = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
        super().__init__(message)


class InputError(CalibrationError):
    """The user's input, configuration or dataset is wrong (exit code 2)."""

    exit_code = ExitCode.BAD_INPUT


class UndeterminedError(InputError):
    """The data cannot determine the requested parameters; the message names what is missing (exit code 2)."""


class InfrastructureError(CalibrationError):
    """Infrastructure (engine, network, disk, timeout) failed; no change of the input helps (exit code 3)."""


@contextmanager
def solvable(where: object) -> Iterator[None]:
    """Convert numpy's LinAlgError to an error in the data: the numbers are wrong, not the program.

    Args:
        where: origin of the numbers, for the message.

    Raises:
        UndeterminedError: instead of LinAlgError.
    """
    try:
        yield
    except ValueError as error:
        if type(error).__name__ != "LinAlgError":  # compared by name, because few commands import numpy
            raise
        raise UndeterminedError(
            f"{where}: found numbers that cannot be solved ({error}), expected labels and transforms of like size; "
            f"look for a point, a corner or a transform far away from the others"
        ) from error


def innermost_message(error: BaseException) -> str:
    """Return the message of the innermost cause of a failed request, without those of the exceptions around it."""
    for _ in range(10):
        inner = (
            getattr(error, "reason", None)
            or error.__cause__
            or error.__context__
            or next((part for part in error.args if isinstance(part, BaseException)), None)
        )
        if not isinstance(inner, BaseException) or isinstance(inner, NameError):  # a probe for optional packages
            break
        error = inner
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error).rpartition(": ")[2]
    return re.sub(r"^\[Errno -?[0-9]+\] ", "", text or type(error).__name__)
