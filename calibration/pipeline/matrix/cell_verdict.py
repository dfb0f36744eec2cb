"""Verdict on cells by rules and limits: on their files after a run, and on results that were judged before."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.tables.rules import RuleSet
from calibration.base.tables.table import EveryRow, parse_table, read_table
from calibration.base.tables.table_verdict import judge
from calibration.ci.report import at_most
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.evaluation.label_errors import REPROJECTION_COLUMNS
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.results import PipelineResults, without_verdicts
from calibration.pipeline.system import System


def judge_cells(cells: Sequence[CellResult], systems: Sequence[System], output: Path) -> tuple[CellResult, ...]:
    """Return the cells with the reasons to fail by their system's rules and limits.

    Raises:
        InputError: a rule names a column or a row that the table of a cell lacks.
    """
    by_name = {system.name: system for system in systems}
    return tuple(_judge_cell(cell, by_name[cell.system], output) for cell in cells)


def check_rules(rules: RuleSet, system: LoadedSystem) -> None:
    """Refuse rules that do not match a system's table, before any calibration.

    They are applied to the table of the uncalibrated dataset, which has the columns and rows of every cell; the values
    are ignored.

    Raises:
        InputError: a column or a row is missing, or a rule needs a table to compare with.
    """
    name = f"{system.name}, rules for {system.evaluation or 'the reprojection errors'}"
    table, complete = _table_to_come(system)
    if table is None:
        return
    if not complete:  # a bad initial guess may lack rows that a calibration has
        rules = RuleSet(tuple(replace(rule, target=EveryRow()) for rule in rules.rules), key_column=rules.key_column)
    if rules.judges:
        judge(parse_table(table.to_csv(), name, ","), rules)


def _table_to_come(system: LoadedSystem) -> tuple[Table | None, bool]:
    """Return a table with the cells' columns, or None if it is unknown; and whether it has every row."""
    if system.evaluation is None:
        labels = tuple(collection.key for collection in system.dataset.collections)
        return Table(
            COLLECTION_HEADER, REPROJECTION_COLUMNS, labels, np.zeros((len(labels), len(REPROJECTION_COLUMNS)))
        ), True
    try:
        table = system.evaluation.run(system.dataset, system.truth)
    except InputError:  # not comparable before the calibration: the cells will report the fault
        return None, False
    return table, not table.left_out


def _judge_cell(cell: CellResult, system: System, output: Path) -> CellResult:
    if cell.error is not None:
        return cell
    reasons = list(_over_limits(cell, system.limits))
    if system.rules is not None:
        if cell.table is None:
            reasons.append("there is no table to judge")
        else:
            verdict = judge(read_table(output / cell.table), system.rules)
            reasons += [violation.message for violation in verdict.violations]
    return replace(cell, reasons=(*cell.reasons, *reasons), undecided_passes=system.undecided == "pass")


def _over_limits(cell: CellResult, limits: Limits) -> list[str]:
    """Return the limits that a cell exceeds; missing and infinite numbers do."""
    truth = cell.truth
    judged = [("RMS", cell.rms_px, limits.rms_px, "px")]
    if truth is not None:  # without truth, suspects and standard deviations are judged instead (`diagnosis`)
        judged += [
            ("translation error against the truth", truth.translation_mm, limits.translation_mm, "mm"),
            ("rotation error against the truth", truth.rotation_deg, limits.rotation_deg, "deg"),
            ("joint translation error against the truth", truth.joint_mm, limits.joint_mm, "mm"),
            ("joint rotation error against the truth", truth.joint_deg, limits.joint_deg, "deg"),
        ]
    judged += [(f"error of task '{e.name}' against the truth", e.truth, e.limit, e.unit) for e in cell.tasks if e.truth]
    checks = (at_most(what, value, limit, unit) for what, value, limit, unit in judged if limit is not None)
    return [str(check) for check in checks if not check.passed]


def judge_results(results: PipelineResults, systems: Sequence[System], output: Path) -> PipelineResults:
    """Return the results with the cells of some systems judged; those of others stay as they are.

    Our engine's references for a team's software are judged too, but do not count for the verdict.

    Args:
        results: of a run.
        systems: systems, with their rules and limits.
        output: its output folder.

    Raises:
        InputError: a rule does not match a table, or a table cannot be read.
    """
    names = {system.name for system in systems}
    fresh = without_verdicts(results)

    def judged(before: Sequence[CellResult], now: Sequence[CellResult]) -> tuple[CellResult, ...]:
        pairs = zip(before, now, strict=True)
        return tuple(
            judge_cells([cell], systems, output)[0] if cell.system in names and not cell.by_other_method else old
            for old, cell in pairs
        )

    return replace(
        fresh,
        cells=judged(results.cells, fresh.cells),
        comparisons=judged(results.comparisons, fresh.comparisons),
    )
