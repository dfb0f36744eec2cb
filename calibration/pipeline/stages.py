"""The stages of a pipeline, one after the other; files go between them, so each can run alone."""

from collections.abc import Sequence
from pathlib import Path

from calibration.errors import InputError
from calibration.pipeline.cell import CellResult
from calibration.pipeline.configuration import System
from calibration.pipeline.judgement import judge_cells
from calibration.pipeline.matrix import Done, Matrix, run_matrix
from calibration.pipeline.report import report
from calibration.pipeline.results import Results, clear_results, read_results, write_results
from calibration.workflow import Runner
from calibration.workflow.progress import progress
from calibration.workflow.text import did_you_mean

STAGES = ("calibrate", "introspect")
"""In their order."""


def run_stages(
    matrix: Matrix,
    output: Path,
    runner: Runner,
    title: str,
    jobs: int | None = None,
    fail_fast: bool = False,
    stages: Sequence[str] = STAGES,
) -> Results:
    """Run stages, and report what the last one found.

    Args:
        matrix: what to calibrate, and how to judge it.
        output: the folder between the stages.
        runner: where to report.
        title: of the annotations.
        jobs: processes; None for one a core.
        fail_fast: whether the first cell that fails stops the others.
        stages: which ones.

    Raises:
        InputError: there is no such stage, or an input is wrong.
        WorldError: a file cannot be written, or a process died.
    """
    for stage in stages:
        if stage not in STAGES:
            raise InputError(f"only: there is no stage '{stage}'{did_you_mean(stage, STAGES)}: {', '.join(STAGES)}")
    results = Results(())
    if "calibrate" in stages:
        with progress(runner, title) as advance:

            def done(count: int, total: int, cell: CellResult) -> None:
                advance(count, total, _line(cell), important=cell.verdict == "fail")

            results = calibrate_stage(matrix, output, jobs, fail_fast, done)
    if "introspect" in stages:
        results = introspect_stage(matrix.systems, output)
    report(results, output, runner, title)
    return results


def _line(cell: CellResult) -> str:
    rms = "" if cell.rms_px is None else f", {cell.rms_px:.4f} px"
    converged = "calibrated" if cell.converged else "not converged"
    return f"{cell.name}: {converged}{rms} ({cell.seconds:.2f} s)"


def calibrate_stage(
    matrix: Matrix, output: Path, jobs: int | None = None, fail_fast: bool = False, done: Done | None = None
) -> Results:
    """Calibrate every cell; it passes when it converged. Leaves results, tables and datasets in ``output``.

    Raises:
        InputError: a dataset, an evaluation or a truth is wrong.
        WorldError: a file cannot be written, or a process died.
    """
    folders = [system.dataset for system in matrix.systems]
    clear_results(output, [path / "dataset.json" if path.is_dir() else path for path in folders])
    found = run_matrix(matrix, output, jobs, fail_fast, done)
    results = Results(found.cells, found.comparisons)
    write_results(results, output)
    return results


def introspect_stage(systems: tuple[System, ...], output: Path) -> Results:
    """Judge the tables that the stage before left in ``output`` by each system's rules and limits.

    Raises:
        InputError: there are no results, or a rule does not fit a table.
        WorldError: a file cannot be written.
    """
    names = {system.name for system in systems}
    found = read_results(output)
    chosen = [cell for cell in found.cells if cell.system in names]
    results = Results(judge_cells(chosen, systems, output), tuple(c for c in found.comparisons if c.system in names))
    write_results(results, output)
    return results
