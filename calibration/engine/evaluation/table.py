"""Tables of numbers with labelled rows, as CSV in ATOM's form."""

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.base import write_atomically
from calibration.base.arrays import Array, BoolArray

AVERAGES_ROW = "Averages"
"""The label of the last row."""
COLLECTION_HEADER = "Collection #"
"""ATOM's header of the labels, of single collections and, in some tables, of pairs."""
COLLECTION_PAIR = "Collection Pair"
"""ATOM's header of the labels in its other tables of pairs."""
RMS_PIX = "RMS (pix)"
"""Column that summarises a table in one number, where there is one."""
MISSING_VALUE = "---"
"""Text of a missing value."""


@dataclass(frozen=True, eq=False)
class Table:
    """Table with one row of numbers for each collection, or pair of collections.

    Raises:
        ValueError: there is no row, or the shapes are inconsistent.
    """

    key: str
    """Header of the column of labels."""
    columns: tuple[str, ...]
    """Headers of the C columns of numbers."""
    labels: tuple[str, ...]
    """Labels of the R rows."""
    values: Array
    """(R, C)."""
    left_out: tuple[str, ...] = field(default=())
    """Skipped rows with the reason, one line each."""
    missing: BoolArray | None = None
    """(R, C): mask of missing values (NaN); None if there is none."""

    def __post_init__(self) -> None:
        if not self.labels or self.values.shape != (len(self.labels), len(self.columns)):
            raise ValueError(
                f"a table of {len(self.labels)} rows, {len(self.columns)} columns, values {self.values.shape}"
            )

    @property
    def averages(self) -> Array:
        """(C,): the arithmetic mean of each column's *printed* values, as in ATOM; NaN if all are missing."""
        printed = np.array([[float(_format_number(v)) for v in row] for row in self.values])
        if self.missing is None:
            return np.asarray(printed.mean(0))
        count = (~self.missing).sum(0)
        total = np.where(self.missing, 0.0, printed).sum(0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def average(self, column: str) -> float:
        """Return the average of one column, by its header."""
        return float(self.averages[self.columns.index(column)])

    def to_csv(self) -> str:
        r"""The table as CSV: a header, the rows, and the row `AVERAGES_ROW`; four decimals, lines end in ``\n``."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([self.key, *self.columns])
        missing = np.zeros(self.values.shape, bool) if self.missing is None else self.missing
        rows = zip(
            (*self.labels, AVERAGES_ROW), [*self.values, self.averages], [*missing, missing.all(axis=0)], strict=True
        )
        for label, row, absent in rows:
            writer.writerow(
                [label, *(MISSING_VALUE if a else _format_number(v) for v, a in zip(row, absent, strict=True))]
            )
        return text.getvalue()

    def write(self, path: Path | str) -> None:
        """Write the table as a CSV file atomically.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        write_atomically(path, self.to_csv())


def _format_number(value: float) -> str:
    """Format a number with four decimals; never a negative zero."""
    text = f"{value:.4f}"
    return "0.0000" if text == "-0.0000" else text
