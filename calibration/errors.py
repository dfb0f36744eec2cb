"""The errors that a user sees: one line each, and the exit code that goes with it."""

import enum
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

LONGEST_MESSAGE = 2000
_LONG_WORD = re.compile(r"([^\s/]{60})[^\s/]{180,}([^\s/]{16})")
"""Longer than a name of a file can be."""


def brief(message: str) -> str:
    """Cut the middle of what a message quotes too long, and of a message that is still too long."""
    message = _LONG_WORD.sub(r"\1…\2", message)
    end = LONGEST_MESSAGE // 4
    return message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - end]}…{message[-end:]}"


class ExitCode(enum.IntEnum):
    """What every command of the suite answers to its caller."""

    PASS = 0
    """The verdict is pass (or there was nothing to judge and the work is done)."""
    FAIL = 1
    """The verdict is fail."""
    BAD_INPUT = 2
    """An input, a configuration or a data file is wrong."""
    INFRASTRUCTURE = 3
    """Infrastructure failed: engine, network, disk, timeout."""


def exit_code_of(passed: bool, errors: Iterable[ExitCode | None]) -> ExitCode:
    """The worst of the errors, 2 or 3, where something could not be done at all; else what the verdict says."""
    return max((error for error in errors if error is not None), default=ExitCode.PASS if passed else ExitCode.FAIL)


class CalibrationError(Exception):
    """An error whose message is meant for the user: one line that says where, what was found, what to do.

    Messages quote what others wrote; what does not print, line ends among it, is escaped, and what is long is cut.
    """

    exit_code: ExitCode = ExitCode.INFRASTRUCTURE

    def __init__(self, message: str) -> None:
        message = brief(message)
        if not message.isprintable():
            message = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
        super().__init__(message)


class InputError(CalibrationError):
    """Something that the user gave is wrong: an input, a configuration, a dataset (exit code 2)."""

    exit_code = ExitCode.BAD_INPUT


class UndeterminedError(InputError):
    """The data cannot determine what was asked; the message names what is missing (exit code 2)."""


class InfrastructureError(CalibrationError):
    """Infrastructure (engine, network, disk, timeout) failed; no change of input repairs it (exit code 3)."""


@contextmanager
def solvable(where: object) -> Iterator[None]:
    """Take numbers that linear algebra cannot solve for what they are: wrong data, never a bug.

    Args:
        where: whose numbers they are, for the message.

    Raises:
        UndeterminedError: in place of numpy's LinAlgError.
    """
    try:
        yield
    except ValueError as error:
        if type(error).__name__ != "LinAlgError":  # by its name: few commands need numpy
            raise
        raise UndeterminedError(
            f"{where}: found numbers that cannot be solved ({error}), expected labels and transforms of like size; "
            f"look for a point, a corner or a transform far away from the others"
        ) from error
