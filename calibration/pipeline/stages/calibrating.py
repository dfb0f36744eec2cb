"""Stages calibrate and introspect: every cell, then rules and limits on the cells' files."""

import os
from dataclasses import replace
from pathlib import Path

from calibration.base import shorten
from calibration.ci.workflow.streams import progress
from calibration.pipeline.baselines import commit_of_run, with_accepted
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.cell_verdict import judge_results
from calibration.pipeline.matrix.matrix import run_matrix
from calibration.pipeline.results import results_of
from calibration.pipeline.stages.running import PipelineRun

MAX_REASON_CHARACTERS = 200
"""Limit of characters of a reason in the log's line of a cell; all of it stands in the results."""


def calibrate_stage(run: PipelineRun) -> PipelineRun:
    """Calibrate every cell, which passes if it converged, and write tables and datasets into the output folder.

    Raises:
        InputError: a dataset, an evaluation, a truth or the baseline is wrong.
        InfrastructureError: a file cannot be written, a process died, or there is no engine.
    """
    matrix, update = run.matrix, None
    if run.baseline is not None:
        matrix, update = with_accepted(run.matrix, run.baseline, os.environ)
    with progress(run.runner, run.title, bar=not run.matrix.software) as advance:

        def done(count: int, total: int, cell: CellResult) -> None:
            advance(count, total, _cell_line(cell), important=not cell.passes)

        found = run_matrix(matrix, run.output, run.jobs, run.fail_fast, done, run.target)
    commit = commit_of_run(run.config.parent if run.config else Path(), os.environ)
    results = replace(run.results, cells=found.cells, comparisons=found.comparisons, baseline=update, commit=commit)
    return replace(run, results=results, given=found.datasets)


def _cell_line(cell: CellResult) -> str:
    rms = "" if cell.rms_px is None else f", {cell.rms_px:.4f} px"
    converged = "calibrated" if cell.converged else "not converged" if cell.error is None else _no_result_text(cell)
    method = "" if cell.by_other_method else f", {cell.method}"  # named in the cell's name
    return f"{cell.name}{method}: {converged}{rms} ({cell.seconds:.2f} s)"


def _no_result_text(cell: CellResult) -> str:
    return f"no result: {shorten('; '.join(cell.reasons), MAX_REASON_CHARACTERS)}"


def introspect_stage(run: PipelineRun) -> PipelineRun:
    """Judge the tables in the output folder by each system's rules and limits.

    If this run has calibrated no cell, the results are read from the output folder, except for this run's image.

    Raises:
        InputError: there are no results, or a rule does not match a table.
    """
    systems = run.matrix.systems
    names = {system.name for system in systems}
    found = run.results if run.results.cells else results_of(run.output)
    asked = replace(
        found,
        cells=tuple(cell for cell in found.cells if cell.system in names),
        comparisons=tuple(cell for cell in found.comparisons if cell.system in names),
        image=run.results.image,
    )
    return replace(run, results=judge_results(asked, systems, run.output))
