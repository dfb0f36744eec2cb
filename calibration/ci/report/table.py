"""Tables of a report: for the log, as Markdown and as CSV."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calibration.base.text import aligned
from calibration.ci.report.blocks import MOST_LINES, Block, cut
from calibration.ci.workflow.markdown import markdown_table


@dataclass(frozen=True)
class Table(Block):
    """A table of strings with a header."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    most_rows: int = MOST_LINES
    """Maximum number of rows in the log and the summary; CSV contains all."""
    rest: str = "results.json"
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
