"""JSON that others wrote, in which no key may stand twice."""

import json
from typing import Any, NoReturn

from calibration.workflow.text import shorten


class RepeatedKeyError(ValueError):
    """An object has a key twice, and one of the two values would be lost."""


def parse_json(text: str | bytes, *, finite: bool = True) -> Any:
    """Parse JSON.

    Args:
        text: the whole document.
        finite: whether NaN and Infinity, which are no JSON, are refused; else they are numbers.

    Raises:
        ValueError: it is no JSON.
        RecursionError: it is nested too deeply.
    """
    return json.loads(text, object_pairs_hook=_object, parse_constant=_refuse if finite else None)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise RepeatedKeyError(f"the key {shorten(repr(repeated))} stands twice")
    return found


def _refuse(text: str) -> NoReturn:
    raise ValueError(f"found {text}, a finite number was expected")
