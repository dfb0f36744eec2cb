"""Tables from CSV files: header, rows, and their line numbers; selections of cells: every row, one, or an aggregate."""

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TypeAlias

from calibration.base.errors import InputError
from calibration.base.files import read_bytes
from calibration.base.text import did_you_mean

MAX_BYTES = 64 * 1024 * 1024
"""Limit of the size of a file."""
DETECTED_DELIMITERS = (",", ";", "\t", "|")
"""Delimiters that are detected, in the order of preference."""

_SAMPLE_CHARACTERS = 64 * 1024  # length of the sample, in characters, for the detection of the delimiter
_DELIMITER_NAMES = {"comma": ",", "semicolon": ";", "tab": "\t", r"\t": "\t", "pipe": "|"}
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before UTF-16, because UTF-32's byte order mark starts with it
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_BINARY_CHARACTER = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a table: as many cells as the header, without surrounding white space."""

    line: int
    """Line of the file where the row starts; the first line is 1."""
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A header and rows of the same length."""

    name: str
    """Name of the table in messages: the path given by the user."""
    header: tuple[str, ...]
    rows: tuple[Row, ...]

    def column(self, name: str) -> int:
        """Return the index of the column with that name.

        Raises :class:`InputError` if the header lacks it, or has it more than once.
        """
        places = [index for index, column in enumerate(self.header) if column == name]
        if not places:
            hint = did_you_mean(name, self.header) or f"; the columns are {', '.join(map(repr, self.header[:20]))}"
            raise InputError(f"{self.name}: there is no column {name!r}{hint}")
        if len(places) > 1:
            numbers = " and ".join(str(index + 1) for index in places)
            raise InputError(f"{self.name}: the column {name!r} occurs more than once in the header, as {numbers}")
        return places[0]


def read_table(path: str | Path, delimiter: str | None = None, encoding: str | None = None) -> Table:
    """Read a CSV file.

    The delimiter is detected among :data:`DETECTED_DELIMITERS` unless given (see :func:`parse_delimiter`);
    the encoding is given, or follows from the byte order mark, else UTF-8, else Latin-1. Quoting,
    any kind of line end and blank lines are supported.

    Raises :class:`InputError` that names the file and the line: for a file that is missing, empty,
    larger than :data:`MAX_BYTES`, binary or in another encoding, with rows of another length than
    the header, or truncated within a row.
    """
    data = read_bytes(Path(path), MAX_BYTES, "a CSV file")
    return parse_table(_decode_text(data, str(path), encoding), str(path), delimiter)


def parse_table(text: str, name: str, delimiter: str | None = None) -> Table:
    """Parse the text of a CSV file as :func:`read_table` does; ``name`` is for messages."""
    text = text.removeprefix("\ufeff")
    binary = _BINARY_CHARACTER.search(text)
    if binary:
        line = text.count("\n", 0, binary.start()) + 1
        raise InputError(
            f"{name}:{line}: this is no CSV file: it holds {binary[0]!r}; if it is text, give its encoding"
        )
    records = _read_records(text, name, delimiter or recognise_delimiter(text))
    _, header = next(records, (0, ()))
    if not any(header):
        raise InputError(f"{name}: there is nothing in the file: a header and rows were expected")
    rows = tuple(Row(line, _fit_to_header(cells, len(header))) for line, cells in records)
    for row in rows:
        if len(row.cells) != len(header):
            found = f"{len(row.cells)} of {len(header)} cells"
            if row is rows[-1] and len(row.cells) < len(header) and not text.endswith(("\n", "\r")):
                raise InputError(f"{name}:{row.line}: the file ends in the middle of a row, after {found}")
            raise InputError(f"{name}:{row.line}: the row has {found} that the header has")
    return Table(name, header, rows)


def recognise_delimiter(text: str) -> str:
    """Return the delimiter for which most rows have as many cells as the header; ties go to most cells."""

    def score(delimiter: str) -> tuple[int, int]:
        lengths = []
        try:
            for _, cells in islice(_read_records(text[:_SAMPLE_CHARACTERS], "", delimiter), 100):
                lengths.append(len(cells))
        except InputError:
            pass  # rows before a malformed row, or before the end of the sample, are used
        return (lengths.count(lengths[0]), lengths[0]) if lengths and lengths[0] > 1 else (0, 0)

    return max(DETECTED_DELIMITERS, key=score)


def parse_delimiter(text: str) -> str:
    r"""Return the delimiter that a user names: comma, semicolon, tab (or ``\t``), pipe, or the character itself.

    Raises :class:`InputError` for anything else.
    """
    delimiter = _DELIMITER_NAMES.get(text.strip().lower(), text)
    if len(delimiter) != 1 or delimiter.isalnum() or delimiter in ' "\r\n.+-':
        raise InputError(f"delimiter: {text!r} is no delimiter: give comma, semicolon, tab, pipe or one character")
    return delimiter


def _decode_text(data: bytes, name: str, encoding: str | None) -> str:
    try:
        if encoding is not None:
            return data.decode(encoding)
        for mark, marked_encoding in _BYTE_ORDER_MARKS:
            if data.startswith(mark):
                return data.decode(marked_encoding)
    except LookupError:
        raise InputError(f"encoding: {encoding!r} is not the name of a text encoding such as utf-8") from None
    except ValueError as error:
        raise InputError(f"{name}: the file is not in the encoding {encoding or marked_encoding}: {error}") from None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _read_records(text: str, name: str, delimiter: str) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the first line and the cells of each record; blank lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True, strict=True)
    line = 1
    try:
        for record in reader:
            cells = tuple(cell.strip() for cell in record)
            if len(cells) > 1 or any(cells):
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as error:
        if "unexpected end of data" in str(error):
            raise InputError(f"{name}:{line}: the file ends in the middle of a row: a quote is never closed") from None
        raise InputError(f"{name}:{line}: the row is not well-formed CSV: {error}") from None


def _fit_to_header(cells: tuple[str, ...], length: int) -> tuple[str, ...]:
    """Remove empty cells beyond the header, which some programs write."""
    return cells[:length] if not any(cells[length:]) else cells


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
