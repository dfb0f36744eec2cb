"""Constraints of values, and conversions between document and record; both are written into ``Annotated``."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from calibration.base.records.place import Place


@dataclass(frozen=True, eq=False)
class Constraint:
    """Condition on a value of the right type."""

    holds: Callable[[Any], bool]
    expected: str
    """Text after "expected" in messages: ``a number of at least 0``; for numbers and lists without the type."""
    schema: Mapping[str, Any] = field(default_factory=dict)
    """The condition as keywords of JSON Schema."""
    whole: bool = False
    """Whether ``expected`` names the type too, so that messages do not."""
    secret: bool = False
    """Whether a wrong value may be a secret and must not be repeated in a message."""


@dataclass(frozen=True, eq=False)
class Converted:
    """Value whose form in the document differs from that in the record.

    ``make`` takes the value read as ``accepts``, and the position for messages; it raises an error for users.
    """

    accepts: Any
    make: Callable[[Any, Place], Any]
    described_as: Any = field(default=None, kw_only=True)
    """Additional keywords of the schema, beyond ``accepts``."""


@dataclass(frozen=True, eq=False)
class ByName:
    """Tuple of records that is a mapping in the document, whose keys are their field ``name``."""

    names: Constraint | None = None


def between(least: float, most: float) -> Constraint:
    """Constrain numbers to ``least`` to ``most``, both included."""
    schema = {"minimum": least, "maximum": most}
    return Constraint(lambda value: least <= value <= most, f"from {least:g} to {most:g}", schema)


def at_least(least: float) -> Constraint:
    """Constrain numbers to at least ``least``."""
    return Constraint(lambda value: value >= least, f"of at least {least:g}", {"minimum": least})


def above(limit: float, most: float | None = None) -> Constraint:
    """Constrain numbers to more than ``limit``, and at most ``most``."""
    schema = {"exclusiveMinimum": limit} | ({} if most is None else {"maximum": most})
    text = f"above {limit:g}" if most is None else f"above {limit:g} and of at most {most:g}"
    return Constraint(lambda value: limit < value and (most is None or value <= most), text, schema)


def matching(pattern: str, expected: str, *, secret: bool = False) -> Constraint:
    """Constrain text to full matches of a regular expression."""
    schema = {"pattern": f"^(?:{pattern})$" if "|" in pattern else f"^{pattern}$"}
    fits = lambda value: re.fullmatch(pattern, value) is not None  # noqa: E731 (compiled for the first value)
    return Constraint(fits, expected, schema, whole=True, secret=secret)


def length(least: int = 0, most: int | None = None) -> Constraint:
    """Constrain the length of text, lists and mappings to ``least`` to ``most``."""

    def holds(value: Any) -> bool:
        return least <= len(value) and (most is None or len(value) <= most)

    if most is None:
        expected = "that is not empty" if least == 1 else f"of at least {least}"
    else:
        expected = f"of {least}" if least == most else f"of {least} to {most}" if least else f"of at most {most}"
    return Constraint(holds, expected, {"length": (least, most)})


UNIQUE = Constraint(lambda value: len(set(value)) == len(value), "without duplicates", {"uniqueItems": True})
"""Lists without duplicates."""
