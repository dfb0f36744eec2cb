"""The matrix: every system from every noisy start, in parallel over the cores.

Where a system has software of the team's own, that calibrates its cells, and our engine calibrates the
same data from the same starts as a comparison, so that "our software got worse" and "the data got worse"
can be told apart.
"""

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.comparison.methods import METHODS, method_of
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import choose_truth
from calibration.errors import InputError
from calibration.estimation.intrinsics_file import read_intrinsics
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.specification import parse_evaluation
from calibration.execution.backends import Place
from calibration.execution.parallel import in_parallel
from calibration.pipeline.matrix.cell import (
    OUR_METHOD,
    Cell,
    CellResult,
    Comparison,
    LoadedSystem,
    noise_folder,
    run_cell,
    run_comparison,
)
from calibration.pipeline.matrix.software import Software
from calibration.pipeline.matrix.software_cell import run_software_cells
from calibration.pipeline.system import Loss, NoiseGrid, Start, System
from calibration.workflow.text import did_you_mean

if TYPE_CHECKING:
    from calibration.workflow.streams import LogDisplay


@dataclass(frozen=True)
class Reference:
    """Our engine on what a cell has the team's software calibrate."""

    cell: Cell

    @property
    def folder(self) -> str:
        """Where its files go: beside those of the cells."""
        return f"{self.cell.system}/{OUR_METHOD}/{noise_folder(self.cell.noise)}"


Job = Cell | Reference | Comparison
"""A cell, our engine's answer to compare it with, or another method on the same data."""
Done = Callable[[int, int, CellResult], None]
"""Called after each job with how many are done, how many there are, and its result."""


@dataclass(frozen=True)
class Matrix:
    """What is to be calibrated."""

    systems: tuple[System, ...]
    noise: NoiseGrid
    start: Start = "linear"
    loss: Loss = "huber"

    @property
    def cells(self) -> list[Cell]:
        """Every combination, system by system."""
        return [Cell(system.name, noise, self.start, self.loss) for system in self.systems for noise in self._starts]

    @property
    def software(self) -> dict[str, Software]:
        """The team's own, by system."""
        return {system.name: system.software for system in self.systems if system.software is not None}

    @property
    def comparisons(self) -> list[Comparison]:
        """Every other method on every system; one that depends on the start from every start.

        Raises:
            InputError: there is no such method.
        """
        return [
            Comparison(system.name, method, noise)
            for system in self.systems
            for method in system.compare
            for noise in (self._starts if method_of(method).from_start else [None])
        ]

    @property
    def _starts(self) -> list[StartingNoise]:
        n = self.noise
        return [StartingNoise(t, r, seed) for t in n.translations for r in n.rotations for seed in n.seeds]


@dataclass(frozen=True)
class MatrixResults:
    """What came of a matrix; cells that were not run, because one failed, are missing."""

    cells: tuple[CellResult, ...]
    comparisons: tuple[CellResult, ...]


def run_matrix(
    matrix: Matrix,
    output: Path,
    jobs: int | None = None,
    fail_fast: bool = False,
    done: Done | None = None,
    display: "LogDisplay | None" = None,
    place: Place | None = None,
) -> MatrixResults:
    """Run all cells and comparisons, each in its own folder below ``output``.

    The results stand in the order of the matrix, whatever the order of execution.

    Args:
        matrix: what to calibrate.
        output: the folder.
        jobs: processes, or containers at once; None for as many as the machine holds.
        fail_fast: whether the first cell that fails stops the others.
        done: called after each job.
        display: where the logs of containers are shown.
        place: where containers run; this machine's engine unless given.

    Raises:
        InputError: a dataset, an evaluation, a truth or an image is wrong; nothing has been calibrated then.
        WorldError: a process died, or containers cannot be run.
    """
    loaded = {system.name: load(system) for system in matrix.systems}
    theirs = [cell for cell in matrix.cells if cell.system in matrix.software]
    ours = [cell for cell in matrix.cells if cell.system not in matrix.software]
    work: list[Job] = [*matrix.comparisons, *ours, *map(Reference, theirs)]  # slow ones first
    results: dict[Job, CellResult] = {}
    software: dict[Cell, CellResult] = {}

    def finished(result: CellResult, counts: bool) -> bool:
        """Tell of a result; whether it stops the others."""
        if done:
            done(len(results) + len(software), len(work) + len(theirs), result)
        return fail_fast and counts and result.verdict == "fail"

    with ExitStack() as stack:
        backend = (
            stack.enter_context((place or Place()).open(display)) if theirs else None
        )  # before long work: it may not be there
        for number, result in in_parallel(partial(_run, loaded=loaded, output=output), work, jobs):
            results[work[number]] = result
            if finished(result, isinstance(work[number], Cell)):
                return _in_order(matrix, results, software)
        if backend is not None:
            answers = run_software_cells(theirs, loaded, matrix.software, output, backend, jobs)
            for number, result in stack.enter_context(closing(answers)):
                software[theirs[number]] = result
                if finished(result, True):
                    break
    return _in_order(matrix, results, software)


def _in_order(matrix: Matrix, results: dict[Job, CellResult], software: dict[Cell, CellResult]) -> MatrixResults:
    cells = [software.get(cell) or results.get(cell) for cell in matrix.cells]
    references = [results.get(Reference(cell)) for cell in matrix.cells]
    others = [results.get(job) for job in matrix.comparisons]
    return MatrixResults(
        tuple(cell for cell in cells if cell), tuple(other for other in (*references, *others) if other)
    )


def load(system: System) -> LoadedSystem:
    """Read a system's data, and check what is to be done with it.

    Raises:
        InputError: the dataset, the truth, the evaluation, a method to compare with or what is known of intrinsics is
            wrong.
    """
    dataset = read_dataset(system.dataset)
    truth = choose_truth(dataset, system.truth)
    for method in system.compare:
        if method not in METHODS:
            raise InputError(
                f"systems.{system.name}.compare: there is no method '{method}'{did_you_mean(method, METHODS)} "
                f"(known: {', '.join(METHODS)})"
            )
    evaluation = parse_evaluation(system.evaluate) if system.evaluate else None
    for sensor in evaluation.sensors if evaluation else ():
        if sensor not in dataset.sensors:
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path} has no sensor '{sensor}'"
                f"{did_you_mean(sensor, dataset.sensors)} (sensors: {', '.join(dataset.sensors)})"
            )
    known = read_intrinsics(system.intrinsics_covariance) if system.intrinsics_covariance else {}
    return LoadedSystem(system.name, dataset, truth, evaluation, system.intrinsics, known, system.hold)


def _run(job: Job, loaded: dict[str, LoadedSystem], output: Path) -> CellResult:
    if isinstance(job, Cell):
        return run_cell(job, loaded[job.system], output)
    if isinstance(job, Reference):
        return run_cell(job.cell, loaded[job.cell.system], output, job.folder)
    return run_comparison(job, loaded[job.system], output)
