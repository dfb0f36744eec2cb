"""Limits of a value, and values that stand otherwise in a document; both are written into ``Annotated``."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.records.reading import Place


@dataclass(frozen=True, eq=False)
class Constraint:
    """A condition that a value of the right type must meet."""

    holds: Callable[[Any], bool]
    expected: str
    """For messages, after "expected": ``a number of at least 0``; for numbers and lists what follows their type."""
    schema: Mapping[str, Any] = field(default_factory=dict)
    """The same as keywords of JSON Schema."""
    whole: bool = False
    """Whether ``expected`` names the type itself."""
    secret: bool = False
    """Whether a wrong value may be a secret, which a message must not repeat."""


@dataclass(frozen=True, eq=False)
class Converted:
    """A value that stands otherwise in the document than in the record.

    ``make`` gets what was read as ``accepts``, and the place for messages; it raises an error for users.
    """

    accepts: Any
    make: Callable[[Any, "Place"], Any]
    described_as: Any = field(default=None, kw_only=True)
    """What the schema says, where that is more than ``accepts``."""


@dataclass(frozen=True, eq=False)
class ByName:
    """A tuple of records that stands in the document as a mapping: its keys are their field ``name``."""

    names: Constraint | None = None


def between(least: float, most: float) -> Constraint:
    """Numbers from ``least`` to ``most``, both included."""
    schema = {"minimum": least, "maximum": most}
    return Constraint(lambda value: least <= value <= most, f"from {least:g} to {most:g}", schema)


def at_least(least: float) -> Constraint:
    """Numbers that are not below ``least``."""
    return Constraint(lambda value: value >= least, f"of at least {least:g}", {"minimum": least})


def above(limit: float, most: float | None = None) -> Constraint:
    """Numbers above ``limit``, and of at most ``most``."""
    schema = {"exclusiveMinimum": limit} | ({} if most is None else {"maximum": most})
    text = f"above {limit:g}" if most is None else f"above {limit:g} and of at most {most:g}"
    return Constraint(lambda value: limit < value and (most is None or value <= most), text, schema)


def matching(pattern: str, expected: str, *, secret: bool = False) -> Constraint:
    """Text that a regular expression matches as a whole."""
    compiled = re.compile(pattern)
    schema = {"pattern": f"^(?:{pattern})$" if "|" in pattern else f"^{pattern}$"}
    fits = lambda value: compiled.fullmatch(value) is not None  # noqa: E731
    return Constraint(fits, expected, schema, whole=True, secret=secret)


def length(least: int = 0, most: int | None = None) -> Constraint:
    """Text, lists and mappings of ``least`` to ``most`` characters, items or keys."""

    def holds(value: Any) -> bool:
        return least <= len(value) and (most is None or len(value) <= most)

    if most is None:
        expected = "that is not empty" if least == 1 else f"of at least {least}"
    else:
        expected = f"of {least}" if least == most else f"of {least} to {most}" if least else f"of at most {most}"
    return Constraint(holds, expected, {"length": (least, most)})


UNIQUE = Constraint(lambda value: len(set(value)) == len(value), "in which nothing stands twice", {"uniqueItems": True})
"""Lists in which no value stands twice."""
