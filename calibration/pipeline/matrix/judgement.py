"""Rules and limits over what the cells left in files."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.diagnosis.limits import Limits
from calibration.introspection.judge import judge
from calibration.introspection.table import read_table
from calibration.pipeline.matrix.cell import CellResult
from calibration.pipeline.system import System
from calibration.report import at_most


def judge_cells(cells: Sequence[CellResult], systems: Sequence[System], output: Path) -> tuple[CellResult, ...]:
    """The cells with the reasons that their system's rules and limits give them to fail.

    Raises:
        InputError: a rule names a column or a row that the table of a cell does not have.
    """
    by_name = {system.name: system for system in systems}
    return tuple(_judged(cell, by_name[cell.system], output) for cell in cells)


def _judged(cell: CellResult, system: System, output: Path) -> CellResult:
    if cell.error is not None:
        return cell
    reasons = list(_over_limits(cell, system.limits))
    if system.rules is not None:
        if cell.table is None:
            reasons.append("there is no table to judge")
        else:
            verdict = judge(read_table(output / cell.table), system.rules)
            reasons += [violation.message for violation in verdict.violations]
    return replace(cell, reasons=(*cell.reasons, *reasons))


def _over_limits(cell: CellResult, limits: Limits) -> list[str]:
    """Why a cell is over a limit; a number that is missing or not finite is."""
    truth = cell.truth
    judged = [("RMS", cell.rms_px, limits.rms_px, "px")]
    if truth is not None:  # without one, what moves a sensor and how well it is determined are judged (`diagnosis`)
        judged += [
            ("translation error against the truth", truth.translation_mm, limits.translation_mm, "mm"),
            ("rotation error against the truth", truth.rotation_deg, limits.rotation_deg, "deg"),
            ("joint translation error against the truth", truth.joint_mm, limits.joint_mm, "mm"),
            ("joint rotation error against the truth", truth.joint_deg, limits.joint_deg, "deg"),
        ]
    checks = (at_most(what, value, limit, unit) for what, value, limit, unit in judged if limit is not None)
    return [str(check) for check in checks if not check.passed]
