"""Sweep of the matrix over each kind of initial guess, with every cell judged as by ``calibrate-matrix``.

An initial guess converges if its cell passes: its result is an optimum (the right one: see
`calibration.engine.estimation.calibrate`), and satisfies the system's rules and limits. Without rules and limits, the
RMS must also be that of the best result of the same method in this sweep, because a wrong optimum would pass. For
software whose dataset has been compared with the optimum, neither is needed.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calibration import __version__
from calibration.base import InputError, temporary_folder
from calibration.base.records import read, text_of
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.tasks import identity, run_tasks, workspace
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import Start
from calibration.pipeline.containers import SOFTWARE_METHOD
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult
from calibration.pipeline.matrix.matrix import Done, Matrix, judge_cells, matrix_tasks
from calibration.pipeline.system import System

CELLS_FOLDER = "cells"
"""Folder, in the output folder, of the files of the team's software."""
MAX_RELATIVE_EXCESS, MAX_EXCESS_PX = 0.01, 0.001
"""Tolerances of the RMS above the best one, relative and in px, within which it is the same optimum."""


def sweep_matrices(matrix: Matrix, starts: Sequence[Start]) -> tuple[Matrix, ...]:
    """Return the matrix for each kind of initial guess. The team's software is only run from the given one.

    Args:
        matrix: systems and noise; the systems' own starts are ignored.
        starts: kinds of initial guesses, each once.

    Raises:
        InputError: there is software, but no given start for it, or no image to run it in.
    """
    for name, software in matrix.software.items():
        if "given" not in starts:
            raise InputError(f"start: found linear, but the software of {name} starts from the guess: add given")
        if not software.container.image:
            raise InputError(f"systems.{name}.software: missing image, or give image; nothing is built here")
    return tuple(
        replace(matrix, systems=tuple(_with_start(system, start) for system in matrix.systems)) for start in starts
    )


def _with_start(system: System, start: Start) -> System:
    """Return a system with another kind of initial guess, without comparison methods, which use none, and datasets."""
    software = system.software if start == "given" else None
    options = replace(system.options, start=start)
    return replace(system, compare=(), software=software, options=options, datasets="none", exports=None)


def run_sweep(
    matrices: Sequence[Matrix],
    output: Path,
    jobs: int | None = None,
    done: Done = lambda *_: None,
    target: ExecutionTarget | None = None,
) -> list[CellResult]:
    """Run and judge every cell. Files of our engine for the rules are removed as soon as they are judged.

    An interrupted sweep is continued by the same call.

    Args:
        matrices: from `sweep_matrices`.
        output: the output folder; its `CELLS_FOLDER` keeps the logs and files of the team's software.
        jobs: number of parallel processes or containers; None for as many as the machine can run.
        done: called after each cell; first for those already finished.
        target: execution target of the containers; by default this machine's engine.

    Returns:
        The judged cells.

    Raises:
        InputError: a dataset, an evaluation, a truth, an image or a rule is wrong.
        InfrastructureError: a process died, containers cannot be run, or a file cannot be written.
    """
    with ExitStack() as stack:
        tasks = []
        work = stack.enter_context(workspace(output, _hash_of_inputs(matrices), text_of, _cell_from_text))
        cells = stack.enter_context(temporary_folder(parent=work.folder, ignore_cleanup_errors=True))
        for matrix in matrices:
            start = matrix.systems[0].options.start
            folder = cells / start
            found = stack.enter_context(matrix_tasks(matrix, folder, output / CELLS_FOLDER))
            judge = partial(_judge_cell, systems=matrix.systems, ours=folder, theirs=output / CELLS_FOLDER)
            named = (replace(task, name=f"{start}/{task.name}") for task in (*found.references, *found.cells))
            tasks += [work.keeping(task.then(judge)) for task in named]
        results = run_tasks(tasks, output / CELLS_FOLDER, jobs, target, work.find, done)
    return _of_the_same_optimum(list(results.values()), matrices[0].systems)


def _hash_of_inputs(matrices: Sequence[Matrix]) -> str:
    """Return a hash of the inputs of all cells, except for their noise: versions, options and files."""
    asked = [matrix.systems for matrix in matrices]
    files = [
        (str(path), status.st_size, status.st_mtime_ns)
        for system in matrices[0].systems
        for path in sorted(_files_of_system(system))
        for status in (path.stat(),)
    ]
    return identity(repr((__version__, np.__version__, asked, files)).encode())


def _files_of_system(system: System) -> Iterator[Path]:
    """Return the files that a system's calibration reads."""
    folder = system.dataset if system.dataset.is_dir() else system.dataset.parent
    yield from (path for path in folder.rglob("*") if path.is_file())
    for path in (system.options.intrinsics_covariance, Path(system.truth) if system.truth else None):
        if isinstance(path, Path) and path.is_file():
            yield path


def _cell_from_text(text: bytes) -> CellResult:
    return read(CellResult, json.loads(text), "a start")


def _judge_cell(cell: CellResult, systems: Sequence[System], ours: Path, theirs: Path) -> CellResult:
    """Judge a cell by rules and limits, and drop its details: thousands would fill disk and memory."""
    folder = ours if cell.method == OUR_METHOD else theirs
    [judged] = judge_cells([cell], systems, folder)
    if cell.method == OUR_METHOD and cell.own_folder is not None:
        shutil.rmtree(folder / cell.own_folder, ignore_errors=True)
    return replace(judged, details=None, warnings=(), findings=())


def _of_the_same_optimum(cells: Sequence[CellResult], systems: Sequence[System]) -> list[CellResult]:
    """Fail the cells with an RMS above the best one, of systems without rules and limits."""
    unjudged = {system.name for system in systems if system.rules is None and system.limits == Limits()}
    best: dict[tuple[str, str], float] = {}
    for cell in cells:
        if cell.verdict != "fail" and cell.rms_px is not None:
            key = (cell.system, cell.method)
            best[key] = min(cell.rms_px, best.get(key, cell.rms_px))
    # The calibrated dataset of the team's software is verified already: it has been compared with the optimum.
    return [
        _compare_with_best(cell, best.get((cell.system, cell.method)))
        if cell.system in unjudged
        and cell.verdict != "fail"
        and not (cell.method == SOFTWARE_METHOD and cell.dataset is not None)
        else cell
        for cell in cells
    ]


def _compare_with_best(cell: CellResult, best: float | None) -> CellResult:
    if cell.rms_px is None or best is None:
        return cell.failing(
            "there is no criterion for convergence: expected rules, limits, or a table with 'RMS (pix)'"
        )
    if cell.rms_px > best * (1 + MAX_RELATIVE_EXCESS) + MAX_EXCESS_PX:
        return cell.failing(f"another optimum: RMS {cell.rms_px:.4f} px, while {best:.4f} px can be reached")
    return cell
