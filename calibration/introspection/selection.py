"""Which of a column's cells a rule judges: every row, one row, or one number made from all of them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import TypeAlias

from calibration.errors import InputError
from calibration.introspection.table import Row, Table
from calibration.workflow.text import did_you_mean

KEY_COLUMNS = ("Collection #", "Collection")
"""Columns that hold the rows' labels in ATOM's tables; else it is the first column."""


@dataclass(frozen=True)
class EveryRow:
    """Every row, each for itself."""

    def __str__(self) -> str:
        return "every row"


@dataclass(frozen=True)
class LabelledRow:
    """The row with a label in the key column."""

    label: str

    def __str__(self) -> str:
        return f"row {self.label}"


@dataclass(frozen=True)
class IndexedRow:
    """A row by its place: 0 is the first, -1 the last."""

    index: int

    def __str__(self) -> str:
        return {0: "first row", -1: "last row"}.get(self.index, f"row index:{self.index}")


@dataclass(frozen=True)
class Aggregate:
    """One number made from every row: max, min, mean, median or a percentile."""

    name: str
    """``max``, ``min``, ``mean``, ``median`` or ``pN``."""

    def __str__(self) -> str:
        return f"{self.name} of every row"

    def __call__(self, values: Sequence[Decimal]) -> Decimal:
        """Return the aggregate of at least one value, as exact as the decimals are written."""
        if self.name in _AGGREGATES:
            return _AGGREGATES[self.name](values)
        return percentile(values, Decimal(self.name[1:]))


Target: TypeAlias = EveryRow | LabelledRow | IndexedRow | Aggregate


def parse_row(text: str) -> LabelledRow | IndexedRow:
    """Read how a user names a row: a label, ``first``, ``last``, ``index:3`` or ``index:-2``.

    ``label:first`` is the row whose label is "first". Raises :class:`InputError`.
    """
    if text in ("first", "last"):
        return IndexedRow(0 if text == "first" else -1)
    kind, separator, rest = text.partition(":")
    if separator and kind == "index":
        if not re.fullmatch(r"-?[0-9]{1,9}", rest):
            raise InputError(f"{text!r}: a whole number was expected after index: (0 is the first row, -1 the last)")
        return IndexedRow(int(rest))
    label = rest if separator and kind == "label" else text
    if not label.strip():
        raise InputError("the label is empty")
    return LabelledRow(label.strip())


def parse_aggregate(text: str) -> Aggregate:
    """Read how a user names an aggregate: max, min, mean, median or a percentile such as ``p95``.

    Raises :class:`InputError`.
    """
    if text in _AGGREGATES:
        return Aggregate(text)
    if re.fullmatch(r"p[0-9]{1,3}(\.[0-9]{1,9})?", text) and float(text[1:]) <= 100:
        return Aggregate(text)
    raise InputError(f"{text!r} is no aggregate: give {', '.join(_AGGREGATES)} or a percentile such as p95")


def percentile(values: Sequence[Decimal], percent: Decimal) -> Decimal:
    """Return the percentile, interpolated linearly between the two nearest values (numpy's default)."""
    ordered = sorted(values)
    place = (len(ordered) - 1) * percent / 100
    lower = int(place)
    upper = min(lower + 1, len(ordered) - 1)
    return ordered[lower] + (ordered[upper] - ordered[lower]) * (place - lower)


_AGGREGATES: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
    "max": max,
    "min": min,
    "mean": lambda values: sum(values, start=Decimal()) / len(values),
    "median": lambda values: percentile(values, Decimal(50)),
}


@dataclass(frozen=True)
class KeyedTable:
    """A table whose rows have labels."""

    table: Table
    key_column: str
    summary_rows: frozenset[str]
    """Labels of rows that sum up others and are no part of "every row"."""

    @classmethod
    def of(cls, table: Table, key_column: str | None, summary_rows: Sequence[str]) -> "KeyedTable":
        """Choose the key column: the given one, else one of :data:`KEY_COLUMNS`, else the first.

        Raises :class:`InputError` when the given one is missing.
        """
        if key_column is not None:
            table.column(key_column)
        found = (name for name in KEY_COLUMNS if name in table.header)
        return cls(table, key_column or next(found, table.header[0]), frozenset(summary_rows))

    @cached_property
    def _key(self) -> int:
        return self.table.header.index(self.key_column)

    @cached_property
    def every_row(self) -> tuple[Row, ...]:
        """The rows that "every row" and the aggregates mean."""
        return tuple(row for row in self.table.rows if self.label(row) not in self.summary_rows)

    @cached_property
    def labels(self) -> frozenset[str]:
        """The labels of all rows."""
        return frozenset(map(self.label, self.table.rows))

    def label(self, row: Row) -> str:
        """Return the label of a row."""
        return row.cells[self._key]

    def row(self, target: LabelledRow | IndexedRow) -> Row | None:
        """Return the chosen row of the whole table; None where the table has too few rows for the index.

        Raises :class:`InputError` when no row has the label, or more than one.
        """
        if isinstance(target, IndexedRow):
            rows = self.table.rows
            return rows[target.index] if -len(rows) <= target.index < len(rows) else None
        found = [row for row in self.table.rows if self.label(row) == target.label]
        if not found:
            hint = did_you_mean(target.label, sorted(self.labels))
            if re.fullmatch(r"-?[0-9]+", target.label):
                hint += f" (by its place a row is index:{target.label})"
            raise InputError(f"{self.table.name}: the column {self.key_column!r} has no row {target.label!r}{hint}")
        if len(found) > 1:
            lines = " and ".join(str(row.line) for row in found[:3])
            raise InputError(f"{self.table.name}: more than one row is labelled {target.label!r}: lines {lines}")
        return found[0]
