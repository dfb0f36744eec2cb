"""Amounts as people write them: ``2g`` of memory, ``1h30m`` of time."""

import math
import re
from typing import Annotated

from calibration.errors import InputError
from calibration.records import Converted

_BYTES = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([kmgt]?)(?:i?b)?", re.IGNORECASE)
_TIMES = re.compile(r"(?:[0-9]+(?:\.[0-9]+)?(?:ms|s|m|h|d)\s*)+")
_TIME = re.compile(r"([0-9]+(?:\.[0-9]+)?)(ms|s|m|h|d)")
_SECONDS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_MOST_BYTES = 2**60
_MOST_SECONDS = 366 * 86400.0


def parse_bytes(value: object, where: str) -> int:
    """Read a number of bytes: 1024, "512 MiB", "2g". As in Docker each unit is 1024 of the one below.

    Raises:
        InputError: it is none, or not above 0; names the key.
    """
    match = _BYTES.fullmatch(str(value).strip()) if _is_amount(value) else None
    if match is not None:
        found = int(float(match[1]) * 1024 ** " kmgt".index(match[2].lower() or " "))
        if 0 < found <= _MOST_BYTES:
            return found
    raise InputError(f"{where}: found {value!r}, expected a size such as 512m or 2g")


def parse_seconds(value: object, where: str) -> float:
    """Read a time in seconds: 45, "90s", "10m", "1h30m".

    Raises:
        InputError: it is none, or not above 0; names the key.
    """
    text = str(value).strip().lower() if _is_amount(value) else ""
    if re.fullmatch(r"[0-9]+(\.[0-9]+)?", text):
        text += "s"
    if _TIMES.fullmatch(text):
        found = math.fsum(float(number) * _SECONDS[unit] for number, unit in _TIME.findall(text))
        if 0 < found <= _MOST_SECONDS:
            return found
    raise InputError(f"{where}: found {value!r}, expected a time such as 90s, 10m or 1h30m, of at most a year")


Bytes = Annotated[int, Converted(str | int, lambda value, place: parse_bytes(value, str(place)))]
"""A field of a record: bytes, as `parse_bytes` reads them."""
Seconds = Annotated[float, Converted(str | float, lambda value, place: parse_seconds(value, str(place)))]
"""A field of a record: seconds, as `parse_seconds` reads them."""


def describe_bytes(count: int) -> str:
    """Write a number of bytes for a message: ``512 MiB``."""
    amount, units = float(count), ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while amount >= 1024 and len(units) > 1:
        amount, units = amount / 1024, units[1:]
    return f"{amount:.4g} {units[0]}"


def _is_amount(value: object) -> bool:
    return isinstance(value, str | int | float) and not isinstance(value, bool) and len(str(value)) < 100
