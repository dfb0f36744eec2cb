"""The stages of a pipeline, one after the other; files go between them, so each can run alone."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.errors import CalibrationError, InputError
from calibration.pipeline.collection.collected import Collected
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.report import pose_line
from calibration.pipeline.configuration import Simulation, System
from calibration.pipeline.matrix.cell import CellResult
from calibration.pipeline.matrix.judgement import judge_cells
from calibration.pipeline.matrix.matrix import Done, Matrix, run_matrix
from calibration.pipeline.report import report
from calibration.pipeline.results import Results, clear_results, read_results, write_results
from calibration.workflow import Runner
from calibration.workflow.progress import progress
from calibration.workflow.text import did_you_mean

if TYPE_CHECKING:
    from calibration.simulation.collection.record import Record

COLLECTED = "collected"
"""The folder of what was collected, in the output folder."""
STAGES = ("calibrate", "introspect", "collect")
"""In their order."""


def run_stages(
    matrix: Matrix,
    output: Path,
    runner: Runner,
    title: str,
    jobs: int | None = None,
    fail_fast: bool = False,
    stages: Sequence[str] = STAGES,
    simulations: Sequence[Simulation] = (),
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
        simulations: what the stage collect collects.

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
    if "collect" in stages and simulations:
        results = collect_stage(simulations, results, output, runner, jobs)
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


def collect_stage(
    simulations: Sequence[Simulation], results: Results, output: Path, runner: Runner, jobs: int | None = None
) -> Results:
    """Collect datasets in simulation, each in its folder below ``output``, and calibrate them.

    One that cannot be collected is among the results, and does not stop the others.

    Args:
        simulations: what to collect.
        results: of the stages before, to which these are added.
        output: the folder between the stages.
        runner: where to show the progress.
        jobs: processes; None for one a core.

    Raises:
        WorldError: a result cannot be written.
    """
    collections = tuple(_collected(simulation, output, runner, jobs) for simulation in simulations)
    results = Results(results.cells, results.comparisons, collections)
    write_results(results, output)
    return results


def _collected(simulation: Simulation, output: Path, runner: Runner, jobs: int | None) -> Collected:
    folder, begin = f"{COLLECTED}/{simulation.name}", time.perf_counter()
    try:
        with progress(runner, f"collect {simulation.name}") as advance:

            def done(count: int, total: int, record: "Record") -> None:
                advance(count, total, f"{simulation.name}: {pose_line(record)}", important=not record.kept)

            found = collect_dataset(simulation.request, output / folder, overwrite=True, jobs=jobs, done=done)
    except CalibrationError as error:
        return Collected(simulation.name, reasons=(str(error),), error=error.exit_code)
    proof = found.proof
    return Collected(
        name=simulation.name,
        poses=len(found.records),
        kept=len(found.kept),
        corner_rms_px=found.corner_rms,
        rms_px=proof.rms_px if proof else None,
        translation_mm=proof.translation_mm if proof else None,
        rotation_deg=proof.rotation_deg if proof else None,
        dataset=folder if found.kept else None,
        reasons=tuple(found.reasons),
        seconds=round(time.perf_counter() - begin, 4),
    )
