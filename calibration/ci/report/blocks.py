"""Blocks of a report (texts, lists, code, tables), each formatted for the log and as Markdown; and its badge as SVG."""

import csv
import io
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

from calibration.base import aligned, code_block, escape_markdown, markdown_table, one_line
from calibration.base.verdict import Verdict

RESULTS_FILE = "results.json"
MOST_LINES = 1000
"""Default limit of lines or rows of a block; files of results contain all."""
BADGE_FILE = "badge.svg"
GOOD, FAIR, BAD, NONE = "#3a7d1e", "#946200", "#b3261e", "#6b6b6b"
"""Dark enough for white text (contrast ratio at least 4.5)."""


def cut(lines: Sequence[str], most: int, rest: str) -> tuple[str, ...]:
    """Return the first lines, and one with the number of the remaining lines and the file that contains them."""
    return tuple(lines) if len(lines) <= most else (*lines[:most], f"and {len(lines) - most} more, see {rest}")


@dataclass(frozen=True, kw_only=True)
class Block(ABC):
    """Part of a report, shown in the log, the summary, or both."""

    title: str = ""
    folded: bool = False
    """Whether the summary shows only the title until a reader opens it."""
    only: Literal["log", "summary", "comment"] | None = None
    """The only place that shows it; None for log and summary."""
    brief: bool = False
    """Whether a comment on a pull request shows it too: a table, or lines."""

    @abstractmethod
    def plain(self) -> str:
        """Return it as lines for the log, without the title; empty if there is nothing to show."""

    @abstractmethod
    def markdown(self) -> str:
        """Return it as Markdown, without the title; empty if there is nothing to show."""


@dataclass(frozen=True)
class Text(Block):
    """A paragraph."""

    text: str

    def plain(self) -> str:
        """Return the paragraph on one line."""
        return one_line(self.text)

    def markdown(self) -> str:
        """Return the paragraph, escaped."""
        return f"{escape_markdown(self.text)}\n" if self.text else ""


@dataclass(frozen=True)
class Lines(Block):
    """A list of lines."""

    lines: tuple[str, ...]
    most: int = MOST_LINES
    """Maximum number of lines that are shown."""
    rest: str = RESULTS_FILE
    """File that contains the remaining lines."""

    def plain(self) -> str:
        """Return the lines, each safe to print."""
        return "\n".join(map(one_line, cut(self.lines, self.most, self.rest)))

    def markdown(self) -> str:
        """Return a list."""
        return "".join(f"- {escape_markdown(line)}\n" for line in cut(self.lines, self.most, self.rest))


@dataclass(frozen=True)
class Code(Block):
    """Output of a program, or commands to copy."""

    text: str

    def plain(self) -> str:
        """Return the text, with each line safe to print."""
        return "\n".join(map(one_line, self.text.splitlines()))

    def markdown(self) -> str:
        """Return a fenced code block."""
        return code_block(self.text) if self.text else ""


@dataclass(frozen=True)
class Table(Block):
    """A table of strings with a header."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    most_rows: int = MOST_LINES
    """Maximum number of rows in the log and the summary; CSV contains all."""
    rest: str = RESULTS_FILE
    """File that contains the remaining rows."""
    most_columns: int | None = None
    """Maximum number of columns beside the first in the log; the remaining ones follow below."""
    empty: str = "-"
    """Text for a missing value; when the log splits columns, rows of missing values are omitted."""

    def plain(self) -> str:
        """Return the table with aligned columns."""
        return "\n\n".join(aligned(part.columns, part._shown_rows()) for part in self.parts() if part.rows)

    def markdown(self) -> str:
        """Return a Markdown table."""
        return markdown_table(self.columns, self._shown_rows()) if self.rows else ""

    def csv(self) -> str:
        r"""Return the table as CSV; lines end in ``\n``."""
        return csv_text(self.columns, self.rows)

    def parts(self) -> "list[Table]":
        """Split the table into parts that are narrow enough for the log, each with the first column."""
        if self.most_columns is None:
            return [self]
        parts = []
        for first in range(1, max(len(self.columns), 2), self.most_columns):
            side = slice(first, first + self.most_columns)
            rows = tuple((row[0], *row[side]) for row in self.rows if set(row[side]) - {self.empty})
            parts.append(Table((self.columns[0], *self.columns[side]), rows, self.most_rows, self.rest))
        return parts

    def _shown_rows(self) -> tuple[tuple[str, ...], ...]:
        labels = cut([row[0] for row in self.rows], self.most_rows, self.rest)
        more = ((labels[-1], *[""] * (len(self.columns) - 1)),) if len(self.rows) > self.most_rows else ()
        return (*self.rows[: self.most_rows], *more)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    r"""Return a header and rows as CSV; lines end in ``\n``, None is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def shown(value: float | None, form: str, unit: str = "", empty: str = "-") -> str:
    """Format a number for a table: ``0.42 mm``."""
    if value is None:
        return empty
    return f"{value:{form}} {unit}" if unit else format(value, form)


def drawn_badge(label: str, text: str, colour: str) -> str:
    """Return a badge as SVG: a label, and a text on a coloured background."""
    left, right = _text_width(label), _text_width(text)
    whole, label, text = left + right, escape(label), escape(text)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="{whole}" height="20" role="img">
<title>{label}: {text}</title>
<clipPath id="r"><rect width="{whole}" height="20" rx="3"/></clipPath>
<g clip-path="url(#r)"><rect width="{left}" height="20" fill="#444"/>
<rect x="{left}" width="{right}" height="20" fill="{colour}"/></g>
<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="{left / 2:g}" y="14">{label}</text><text x="{left + right / 2:g}" y="14">{text}</text></g>
</svg>
"""


def verdict_badge(verdict: Verdict) -> str:
    """Return the badge of a calibration's verdict as SVG: green for pass, amber for undecided, red for fail."""
    return drawn_badge("calibration", verdict, {"pass": GOOD, "undecided": FAIR, "fail": BAD}[verdict])


def _text_width(text: str) -> int:
    return 10 + 7 * len(text)
