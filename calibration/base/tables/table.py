"""Tables from CSV files: header, rows, and their line numbers."""

import codecs
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

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
