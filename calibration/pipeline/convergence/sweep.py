"""The sweep: the matrix run once for each kind of start, every cell judged as ``calibrate-matrix`` judges it.

A start converges when its cell passes: what it led to is an optimum (the right one: see
`calibration.estimation.calibrate`), and keeps to the system's rules and limits. A system that has neither asks for
no optimum, so there the RMS counts too: it is that of the best start of the same method in this sweep.
"""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from calibration.errors import InputError, WorldError
from calibration.execution.backends import Place
from calibration.pipeline.matrix.cell import OUR_METHOD, CellResult
from calibration.pipeline.matrix.judgement import judge_cells
from calibration.pipeline.matrix.matrix import Done, Matrix, run_matrix
from calibration.pipeline.system import Limits, Start, System

if TYPE_CHECKING:
    from calibration.workflow.streams import LogDisplay

CELLS = "cells"
"""The folder, in the output folder, of what the team's software leaves."""
SAME_RELATIVE, SAME_PX = 0.01, 0.001
"""An RMS that exceeds the best by no more than this share and these pixels is of the same optimum."""


def sweep_matrices(matrix: Matrix, starts: Sequence[Start]) -> tuple[Matrix, ...]:
    """The matrix for each kind of start. The team's software starts from the given guess; it is run in that one only.

    Args:
        matrix: systems, noise and loss; its own start does not count.
        starts: each once.

    Raises:
        InputError: there is software, but no given start for it, or no image to run it in.
    """
    for name, software in matrix.software.items():
        if "given" not in starts:
            raise InputError(f"start: found linear, but the software of {name} starts from the guess: add given")
        if not software.container.image:
            raise InputError(f"systems.{name}.software: missing image, or give image; nothing is built here")
    systems = tuple(replace(system, compare=()) for system in matrix.systems)  # other methods take no start
    ours = tuple(replace(system, software=None) for system in systems)
    return tuple(replace(matrix, systems=systems if start == "given" else ours, start=start) for start in starts)


def run_sweep(
    matrices: Sequence[Matrix],
    output: Path,
    jobs: int | None = None,
    done: Done | None = None,
    display: "LogDisplay | None" = None,
    place: Place | None = None,
) -> list[CellResult]:
    """Run every cell, and judge it. What our engine writes for the rules to judge is removed as soon as it is judged.

    Args:
        matrices: of `sweep_matrices`.
        output: the folder; `CELLS` in it keeps the logs and files of the team's software.
        jobs: processes, or containers at once; None for as many as the machine holds.
        done: called after each cell.
        display: where the logs of containers are shown.
        place: where containers run; this machine's engine unless given.

    Returns:
        The judged cells, in the order in which they came.

    Raises:
        InputError: a dataset, an evaluation, a truth, an image or a rule is wrong.
        WorldError: a process died, containers cannot be run, or a file cannot be written.
    """
    total = sum(_jobs(matrix) for matrix in matrices)
    cells: list[CellResult] = []
    for matrix in matrices:
        with _folder(matrix, output) as folder:
            judge = partial(_judge, matrix.systems, folder, cells, total, done)
            run_matrix(matrix, folder, jobs, done=judge, display=display, place=place)
    return _of_the_same_optimum(cells, matrices[0].systems)


def _jobs(matrix: Matrix) -> int:
    """How many cells a matrix runs: beside each of the team's software there is one of our engine."""
    return len(matrix.cells) + sum(cell.system in matrix.software for cell in matrix.cells)


def _judge(
    systems: Sequence[System],
    folder: Path,
    cells: list[CellResult],
    total: int,
    done: Done | None,
    _count: int,
    _total: int,
    cell: CellResult,
) -> None:
    """Take a cell of one of the matrices among the cells of all of them."""
    cells.append(_judged(cell, systems, folder))
    if done:
        done(len(cells), total, cells[-1])


@contextmanager
def _folder(matrix: Matrix, output: Path) -> Iterator[Path]:
    """Where the cells write."""
    if matrix.software:
        yield output / CELLS
        return
    try:
        output.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".cells-", dir=output, ignore_cleanup_errors=True) as folder:
            yield Path(folder)
    except OSError as error:
        raise WorldError(f"{output}: cannot be written: {error.strerror or error}") from error


def _judged(cell: CellResult, systems: Sequence[System], folder: Path) -> CellResult:
    """The cell by rules and limits, without what is not needed any more: thousands of it would fill disk and memory."""
    [judged] = judge_cells([cell], systems, folder)
    if cell.method == OUR_METHOD and cell.dataset is not None:
        shutil.rmtree((folder / cell.dataset).parent, ignore_errors=True)
    return replace(judged, details={}, warnings=())


def _of_the_same_optimum(cells: Sequence[CellResult], systems: Sequence[System]) -> list[CellResult]:
    """The cells; of systems without rules and limits, those with an RMS above the best fail."""
    unjudged = {system.name for system in systems if system.rules is None and system.limits == Limits()}
    best: dict[tuple[str, str], float] = {}
    for cell in cells:
        if cell.verdict == "pass" and cell.rms_px is not None:
            key = (cell.system, cell.method)
            best[key] = min(cell.rms_px, best.get(key, cell.rms_px))
    return [
        _compared(cell, best.get((cell.system, cell.method)))
        if cell.system in unjudged and cell.verdict == "pass"
        else cell
        for cell in cells
    ]


def _compared(cell: CellResult, best: float | None) -> CellResult:
    if cell.rms_px is None or best is None:
        return cell.failing("nothing says whether it is right: expected rules, limits, or a table with 'RMS (pix)'")
    if cell.rms_px > best * (1 + SAME_RELATIVE) + SAME_PX:
        return cell.failing(f"another optimum: RMS {cell.rms_px:.4f} px, while {best:.4f} px can be reached")
    return cell
