"""Parsing of amounts: ``2g`` of memory, ``1h30m`` of time."""

import math
import re
from typing import Annotated, TypeGuard

from calibration.base import InputError
from calibration.base.records import Converted

_SIZE_TEXT = r"([0-9]+(?:\.[0-9]+)?)\s*([kmgt]?)(?:i?b)?"
_DURATION_TEXT = r"(?:[0-9]+(?:\.[0-9]+)?(?:ms|s|m|h|d)\s*)+"
_DURATION_PART = r"([0-9]+(?:\.[0-9]+)?)(ms|s|m|h|d)"
_SECONDS_OF_UNIT = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_MOST_BYTES = 2**60
_MOST_SECONDS = 366 * 86400.0


def parse_bytes(value: object, where: str) -> int:
    """Parse a number of bytes: 1024, "512 MiB", "2g". As in Docker, units are powers of 1024.

    Raises:
        InputError: it is not a size above 0; the message names the key.
    """
    match = re.fullmatch(_SIZE_TEXT, str(value).strip(), re.IGNORECASE) if _is_amount(value) else None
    if match is not None:
        found = int(float(match[1]) * 1024 ** " kmgt".index(match[2].lower() or " "))
        if 0 < found <= _MOST_BYTES:
            return found
    raise InputError(f"{where}: found {value!r}, expected a size such as 512m or 2g")


def parse_seconds(value: object, where: str) -> float:
    """Parse a time in seconds: 45, "90s", "10m", "1h30m".

    Raises:
        InputError: it is not a time above 0; the message names the key.
    """
    found = 0.0
    if isinstance(value, str) and len(value) < 100:
        text = value.strip().lower()
        text += "s" if re.fullmatch(r"[0-9]+(\.[0-9]+)?", text) else ""
        if re.fullmatch(_DURATION_TEXT, text):
            found = math.fsum(
                float(number) * _SECONDS_OF_UNIT[unit] for number, unit in re.findall(_DURATION_PART, text)
            )
    elif _is_amount(value):
        found = float(value)
    if 0 < found <= _MOST_SECONDS:
        return found
    raise InputError(f"{where}: found {value!r}, expected a time such as 90s, 10m or 1h30m, of at most a year")


Bytes = Annotated[int, Converted(str | int, lambda value, place: parse_bytes(value, str(place)))]
"""Type of a record's field: bytes, parsed by `parse_bytes`."""
Seconds = Annotated[float, Converted(str | float, lambda value, place: parse_seconds(value, str(place)))]
"""Type of a record's field: seconds, parsed by `parse_seconds`."""


def describe_bytes(count: int) -> str:
    """Format a number of bytes for a message: ``512 MiB``."""
    amount, units = float(count), ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while amount >= 1024 and len(units) > 1:
        amount, units = amount / 1024, units[1:]
    return f"{amount:.4g} {units[0]}"


def _is_amount(value: object) -> TypeGuard[str | float]:
    return isinstance(value, str | int | float) and not isinstance(value, bool) and len(str(value)) < 100
