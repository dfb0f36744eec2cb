"""Selection of the cells that a rule judges: every row, one row, or an aggregate of all rows."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import TypeAlias

from calibration.base.errors import InputError
from calibration.base.tables.table import Row, Table
from calibration.base.text import did_you_mean

KEY_COLUMNS = ("Collection #", "Collection")
"""Columns of row labels in ATOM's tables; the default is the first column."""


@dataclass(frozen=True)
class EveryRow:
    """Selection of every row, individually."""

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
    """A row by its index: 0 is the first, -1 the last."""

    index: int

    def __str__(self) -> str:
        return {0: "first row", -1: "last row"}.get(self.index, f"row index:{self.index}")


@dataclass(frozen=True)
class Aggregate:
    """Aggregate of every row: max, min, mean, median or a percentile."""

    name: str
    """``max``, ``min``, ``mean``, ``median`` or ``pN``."""

    def __str__(self) -> str:
        return f"{self.name} of every row"

    def __call__(self, values: Sequence[Decimal]) -> Decimal:
        """Return the aggregate of at least one value, in exact decimal arithmetic."""
        if self.name in _AGGREGATE_FUNCTIONS:
            return _AGGREGATE_FUNCTIONS[self.name](values)
        return percentile(values, Decimal(self.name[1:]))


Target: TypeAlias = EveryRow | LabelledRow | IndexedRow | Aggregate


def parse_row(text: str) -> LabelledRow | IndexedRow:
    """Parse the selection of a row: a label, ``first``, ``last``, ``index:3`` or ``index:-2``.

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
    """Parse the name of an aggregate: max, min, mean, median or a percentile such as ``p95``.

    Raises :class:`InputError`.
    """
    if text in _AGGREGATE_FUNCTIONS:
        return Aggregate(text)
    if re.fullmatch(r"p[0-9]{1,3}(\.[0-9]{1,9})?", text) and float(text[1:]) <= 100:
        return Aggregate(text)
    raise InputError(f"{text!r} is no aggregate: give {', '.join(_AGGREGATE_FUNCTIONS)} or a percentile such as p95")


def percentile(values: Sequence[Decimal], percent: Decimal) -> Decimal:
    """Return the percentile, with linear interpolation between the two nearest values (numpy's default)."""
    ordered = sorted(values)
    place = (len(ordered) - 1) * percent / 100
    lower = int(place)
    upper = min(lower + 1, len(ordered) - 1)
    return ordered[lower] + (ordered[upper] - ordered[lower]) * (place - lower)


_AGGREGATE_FUNCTIONS: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
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
    """Labels of summary rows, which are excluded from "every row"."""

    @classmethod
    def of(cls, table: Table, key_column: str | None, summary_rows: Sequence[str]) -> "KeyedTable":
        """Select the key column: the given one, else one of :data:`KEY_COLUMNS`, else the first.

        Raises :class:`InputError` if the given one is missing.
        """
        if key_column is not None:
            table.column(key_column)
        found = (name for name in KEY_COLUMNS if name in table.header)
        return cls(table, key_column or next(found, table.header[0]), frozenset(summary_rows))

    @cached_property
    def _key_index(self) -> int:
        return self.table.header.index(self.key_column)

    @cached_property
    def every_row(self) -> tuple[Row, ...]:
        """Rows that count as "every row" and for the aggregates."""
        return tuple(row for row in self.table.rows if self.label(row) not in self.summary_rows)

    @cached_property
    def labels(self) -> frozenset[str]:
        """The labels of all rows."""
        return frozenset(map(self.label, self.table.rows))

    def label(self, row: Row) -> str:
        """Return the label of a row."""
        return row.cells[self._key_index]

    def row(self, target: LabelledRow | IndexedRow) -> Row | None:
        """Return the selected row of the whole table; None if the table has too few rows for the index.

        Raises :class:`InputError` if no row has the label, or more than one.
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
