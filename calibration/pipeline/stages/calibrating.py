"""The stages calibrate and introspect: every cell, then rules and limits over what the cells left in files."""

from dataclasses import replace
from pathlib import Path

from calibration.execution.backends import Place
from calibration.pipeline.matrix.cell import CellResult
from calibration.pipeline.matrix.judgement import judge_cells
from calibration.pipeline.matrix.matrix import Matrix, run_matrix
from calibration.pipeline.report import write_results
from calibration.pipeline.results import Results, read_results, without_verdicts
from calibration.pipeline.system import System
from calibration.workflow import Runner
from calibration.workflow.progress import progress


def calibrate_stage(
    matrix: Matrix,
    results: Results,
    output: Path,
    runner: Runner,
    title: str = "calibrate",
    jobs: int | None = None,
    fail_fast: bool = False,
    place: Place | None = None,
) -> Results:
    """Calibrate every cell; it passes when it converged. Leaves results, tables and datasets in ``output``.

    Args:
        matrix: what to calibrate.
        results: of the stages before, to which these are added.
        output: the folder between the stages.
        runner: where to show the progress, and the logs of containers.
        title: of the progress.
        jobs: processes, or containers at once; None for as many as the machine holds.
        fail_fast: whether the first cell that fails stops the others.
        place: where containers run; this machine's engine unless given.

    Raises:
        InputError: a dataset, an evaluation or a truth is wrong.
        WorldError: a file cannot be written, a process died, or there is no engine.
    """
    with progress(runner, title, bar=not matrix.software) as advance:

        def done(count: int, total: int, cell: CellResult) -> None:
            advance(count, total, _line(cell), important=cell.verdict == "fail")

        found = run_matrix(matrix, output, jobs, fail_fast, done, place)
    results = replace(results, cells=found.cells, comparisons=found.comparisons)
    write_results(results, output)
    return results


def _line(cell: CellResult) -> str:
    rms = "" if cell.rms_px is None else f", {cell.rms_px:.4f} px"
    converged = "calibrated" if cell.converged else "not converged"
    method = "" if cell.by_other_method else f", {cell.method}"  # whose name says it
    return f"{cell.name}{method}: {converged}{rms} ({cell.seconds:.2f} s)"


def introspect_stage(systems: tuple[System, ...], results: Results, output: Path) -> Results:
    """Judge the tables that the stage before left in ``output`` by each system's rules and limits.

    Our engine's answers beside those of a team's software are judged too, without a part in the verdict.

    Args:
        systems: whose tables.
        results: of the stages before; what they say of an image stays, the rest is read from ``output``.
        output: the folder between the stages.

    Raises:
        InputError: there are no results, or a rule does not fit a table.
        WorldError: a file cannot be written.
    """
    names = {system.name for system in systems}
    found = without_verdicts(read_results(output), output)
    cells = [cell for cell in found.cells if cell.system in names]
    references = [cell for cell in found.comparisons if cell.system in names and not cell.by_other_method]
    others = [cell for cell in found.comparisons if cell.system in names and cell.by_other_method]
    results = replace(
        found,
        cells=judge_cells(cells, systems, output),
        comparisons=(*judge_cells(references, systems, output), *others),
        image=results.image,
    )
    write_results(results, output)
    return results
