"""Strict parsing of untrusted JSON: repeated keys are errors."""

import json
from typing import Any, NoReturn

from calibration.base.text import shorten


class RepeatedKeyError(ValueError):
    """An object has a repeated key, of which one value would be lost."""


def parse_json(text: str | bytes, *, finite: bool = True) -> Any:
    """Parse JSON.

    Args:
        text: the whole document.
        finite: refuse NaN and Infinity, which are not valid JSON; otherwise they are parsed as numbers.

    Raises:
        ValueError: it is not valid JSON.
        RecursionError: it is nested too deeply.
    """
    return json.loads(
        text, object_pairs_hook=_object_without_repeats, parse_constant=_refuse_constant if finite else None
    )


def _object_without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise RepeatedKeyError(f"the key {shorten(repr(repeated))} occurs twice")
    return found


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"found {text}, a finite number was expected")
