"""Accept the results of a run as the baseline of its systems."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.base.errors import InputError
from calibration.base.tables.selection import KeyedTable, LabelledRow
from calibration.base.tables.table import read_table
from calibration.base.text import did_you_mean, parse_number, shorten
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import BASELINE_VERSION, Baseline
from calibration.engine.diagnosis.finding import FindingKind
from calibration.engine.evaluation.table import AVERAGES_ROW
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult
from calibration.pipeline.matrix.software_cell import start_of
from calibration.pipeline.results import PipelineResults, own_details

ABOUT_THE_BASELINE: tuple[FindingKind, ...] = ("baseline", "baseline-quality", "no-baseline")
"""Kinds of findings that are resolved by accepting."""


def accept(
    results: PipelineResults, output: Path, names: Sequence[str], although: str | None, before: Baseline | None
) -> tuple[Baseline, tuple[str, ...]]:
    """Return the baseline with the results of a run.

    Args:
        results: of the run.
        output: its output folder.
        names: the systems to accept; empty for all.
        although: reason for accepting a system that has failed.
        before: the baseline so far; other systems are unchanged.

    Returns:
        The baseline, and the names of the accepted systems.

    Raises:
        InputError: a system is not in the results, has no calibration, or has failed without a reason for accepting it.
    """
    known = tuple(dict.fromkeys(cell.system for cell in results.cells))
    for name in names:
        if name not in known:
            raise InputError(
                f"{output}: there is no result of '{name}'{did_you_mean(name, known)} (found: {', '.join(known)})"
            )
    accepted = {name: _accepted_snapshot(name, results, output, although) for name in names or known}
    if not accepted:
        raise InputError(f"{output}: there is no calibrated system to accept: run the calibration first")
    systems = {**(before.systems if before else {}), **accepted}
    return Baseline(BASELINE_VERSION, dict(sorted(systems.items()))), tuple(accepted)


def _accepted_snapshot(
    system: str, results: PipelineResults, output: Path, although: str | None
) -> CalibrationDocument:
    cells = [cell for cell in results.cells if cell.system == system]
    failed = [(cell, why) for cell in cells if (why := _unsettled_reasons(cell))]
    if failed and although is None:
        cell, why = failed[0]
        what = "has failed" if cell.verdict == "fail" else "is undecided"
        raise InputError(
            f"{cell.name}: {what} ({shorten(why[0], 200)}); what {what} is accepted with --although 'why' only"
        )
    references = [cell for cell in results.comparisons if cell.system == system and not cell.by_other_method]
    ours = [cell for cell in cells if cell.method == OUR_METHOD] or references
    for cell in ours:
        details = own_details(cell, output) if cell.converged else None
        if details is not None and details.snapshot is not None:
            return replace(
                details.snapshot,
                averages=_table_averages(output / cell.table) if cell.table else {},
                passed=len(cells) - len(failed),
                starts=len(cells),
                software=tuple(
                    start_of(cell, not _unsettled_reasons(cell)) for cell in cells if cell.method != OUR_METHOD
                ),
                although=although if failed else None,
            )
    raise InputError(f"{output}: {system}: no cell has a calibration that could be accepted")


def _unsettled_reasons(cell: CellResult) -> tuple[str, ...]:
    """Return the reasons why a cell has failed, without those that accepting resolves."""
    settled = {finding.text for finding in cell.findings if finding.kind in ABOUT_THE_BASELINE}
    reasons = tuple(reason for reason in cell.reasons if reason not in settled)
    if not reasons and cell.verdict == "undecided" and not cell.undecided_passes:
        reasons = cell.undecided
    return reasons or (() if cell.converged else ("it has not converged",))


def _table_averages(path: Path) -> dict[str, float]:
    """Return the row of averages of a table, by column; empty if there is none."""
    table = read_table(path)
    keyed = KeyedTable.of(table, None, ())
    row = keyed.row(LabelledRow(AVERAGES_ROW)) if AVERAGES_ROW in keyed.labels else None
    numbers = {} if row is None else {column: parse_number(row.cells[table.column(column)]) for column in table.header}
    return {column: number for column, number in numbers.items() if number is not None}
