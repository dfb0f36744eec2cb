"""Verdict on the results of a run by rules and limits, whatever was judged before."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.cell_verdict import judge_cells
from calibration.pipeline.results import Results, without_verdicts
from calibration.pipeline.system import System


def judge_results(results: Results, systems: Sequence[System], output: Path) -> Results:
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
