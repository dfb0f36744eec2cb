"""Check that another software's table of errors agrees with its calibrated dataset."""

from collections.abc import Iterator

import numpy as np

from calibration.base.arrays import Array
from calibration.base.tables.numbers import parse_number
from calibration.base.tables.selection import KeyedTable
from calibration.base.tables.table import Table as Csv
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.evaluation.table import AVERAGES_ROW, Table

FINDING_KIND = "table"
ROW_TOLERANCE, AVERAGE_TOLERANCE = 0.1, 0.05
"""Relative tolerance of a value: of one collection, and of an average. Both tables evaluate the same transforms, but
the pose of a pattern estimated from a view, or the border found in an image, depends slightly on the implementation.
"""
MAX_DIGIT_TOLERANCE = 0.1
"""Limit of the unit of the last digit as a tolerance, so that "0" is not taken for any value rounded to it; averages,
which a verdict depends on, have their relative tolerance as the limit.
"""
NO_NOISE = 0.1
"""No calibration has a smaller RMS than this fraction of the optimum's on the same labels."""


def table_follows(theirs: Csv, made: Table) -> tuple[Finding, ...]:
    """Report a failure for the first value of a table that differs from our evaluation of the same dataset.

    Columns and rows that both have are compared, and the averages: software may leave out a collection, but then
    the averages reveal it.

    Args:
        theirs: the table that the software left.
        made: the table of its calibrated dataset.
    """
    columns = [column for column in made.columns if theirs.header.count(column) == 1]
    if not columns:
        text = (
            f"the table is not verified: it has no column of the one that evaluate asks for ({', '.join(made.columns)})"
        )
        return (Finding(FINDING_KIND, "note", text),)
    keyed = KeyedTable.of(theirs, None, ())
    of_label = {
        _without_leading_zeros(label): values for label, values in zip(made.labels, _values_of_table(made), strict=True)
    }
    of_label[AVERAGES_ROW] = made.averages
    if not any(_without_leading_zeros(keyed.label(row)) in of_label for row in theirs.rows):
        text = f"the table has no row of the collections of its dataset ({', '.join(made.labels[:3])}, ...)"
        return (Finding(FINDING_KIND, "red", text),)
    wrong = list(_describe_wrong_values(keyed, columns, made, of_label))
    if not wrong:
        return ()
    more = f", and {len(wrong) - 1} more values differ" if len(wrong) > 1 else ""
    text = f"{wrong[0]}{more}: the table does not follow from the calibrated dataset"
    return (Finding(FINDING_KIND, "red", text),)


def _values_of_table(made: Table) -> Array:
    """Return the numbers of a table; NaN for empty cells."""
    return made.values if made.missing is None else np.where(made.missing, np.nan, made.values)


def _describe_wrong_values(
    keyed: KeyedTable, columns: list[str], made: Table, of_label: dict[str, Array]
) -> Iterator[str]:
    """Describe each value that differs."""
    places = [(column, keyed.table.column(column), made.columns.index(column)) for column in columns]
    for row in keyed.table.rows:
        label = _without_leading_zeros(keyed.label(row))
        if label not in of_label:
            continue
        share = AVERAGE_TOLERANCE if label == AVERAGES_ROW else ROW_TOLERANCE
        for column, there, here in places:
            text, ours = row.cells[there], float(of_label[label][here])
            if np.isfinite(ours) and not _is_near(text, ours, share):
                where = "on average" if label == AVERAGES_ROW else f"for {keyed.label(row)}"
                yield f"the table says {column} {text or 'nothing'} {where}, its dataset gives {ours:.4g}"


def _is_near(text: str, ours: float, share: float) -> bool:
    """Whether a printed number equals ours within a relative tolerance, and a unit of its last digit if small."""
    number = parse_number(text)
    if number is None:
        return False
    mantissa, _, exponent = text.lower().partition("e")
    decimals = min(len(mantissa.partition(".")[2]) - int(exponent or 0), 300)
    coarse = share * abs(ours) if share == AVERAGE_TOLERANCE else MAX_DIGIT_TOLERANCE
    return abs(number - ours) <= share * abs(ours) + max(min(10.0**-decimals, coarse), 1e-4)


def _without_leading_zeros(label: str) -> str:
    """Return a row's label without leading zeros: "7" and "007" are one collection, "0-1" and "000-001" one pair."""
    return "-".join(part.lstrip("0") or "0" if part.isdigit() else part for part in label.split("-"))


def not_evaluated(rms_px: float | None, noise_px: float) -> tuple[Finding, ...]:
    """Check a table of unknown kind: a failure if its RMS is below the labels' noise.

    Args:
        rms_px: the average of the table; None where it has none.
        noise_px: root mean square of the reprojection errors at our optimum; NaN if there is no camera.
    """
    if rms_px is not None and rms_px < NO_NOISE * noise_px:
        text = (
            f"the table says RMS {rms_px:.4g} px, but the noise of the labels leaves {noise_px:.4g} px at the optimum"
        )
        return (Finding(FINDING_KIND, "red", text, value=rms_px, unit="px"),)
    return (Finding(FINDING_KIND, "note", "the table is not verified: evaluate does not say which one it is"),)
