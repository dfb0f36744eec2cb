"""Position in a document that is read, and the errors there."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.base.errors import CalibrationError, InputError
from calibration.base.text import shorten

_MAX_LISTED_NUMBERS = 3
"""Limit of the numbers of a list in a message."""


class Misfit(ValueError):  # noqa: N818 (it becomes an error for users where the place is known)
    """Error for values that are valid alone and contradict each other; ``key`` is the one to change."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class Place:
    """Position in a document, for messages, with the context of reading."""

    where: str
    """The file, and the key in it if the document is a part of one."""
    keys: tuple[str, ...] = ()
    folder: Path = Path()
    """Base folder of relative paths."""
    error: type[CalibrationError] = InputError

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.where, ".".join(self.keys))))

    def below(self, key: object) -> "Place":
        """Return the position of a key or an item in this one."""
        return replace(self, keys=(*self.keys, str(key)))

    def fault(self, message: str) -> CalibrationError:
        """Return the error with this message."""
        return self.error(f"{self}: {message}")

    def unexpected(self, value: object, expected: str) -> CalibrationError:
        """Return the error with the found and the expected value."""
        return self.fault(f"found {shown(value)}, expected {expected}")

    def misfit(self, misfit: Misfit) -> CalibrationError:
        """Return the error about contradicting values."""
        return (self.below(misfit.key) if misfit.key else self).fault(str(misfit))


def shown(value: object) -> str:
    """Format a value for a message, shortened."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, dict):
        return f"a mapping of {len(value)} keys" if value else "an empty mapping"
    if isinstance(value, list) and not (1 < len(value) <= _MAX_LISTED_NUMBERS and all(map(is_number, value))):
        return f"a list of {len(value)}" if value else "an empty list"
    return shorten(repr(value))


def is_number(value: object) -> bool:
    """Whether a value is a finite number, not true or false."""
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # integers beyond the range of floats
        return False
