"""The matrix: every system from every noisy start, in parallel over the cores."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calibration.comparison.methods import METHODS
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import find_truth, read_truth, truth_of
from calibration.errors import InputError
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.specification import parse_evaluation
from calibration.execution.parallel import in_parallel
from calibration.pipeline.configuration import Loss, NoiseGrid, Start, System
from calibration.pipeline.matrix.cell import Cell, CellResult, LoadedSystem, run_cell, run_comparison
from calibration.workflow.text import did_you_mean

Job = Cell | tuple[str, str]
"""A cell, or (system, other method)."""
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
        return [
            Cell(system.name, StartingNoise(t, r, seed), self.start, self.loss)
            for system in self.systems
            for t in self.noise.translations
            for r in self.noise.rotations
            for seed in self.noise.seeds
        ]

    @property
    def comparisons(self) -> list[tuple[str, str]]:
        """Every (system, other method)."""
        return [(system.name, method) for system in self.systems for method in system.compare]


@dataclass(frozen=True)
class MatrixResults:
    """What came of a matrix; cells that were not run, because one failed, are missing."""

    cells: tuple[CellResult, ...]
    comparisons: tuple[CellResult, ...]


def run_matrix(
    matrix: Matrix, output: Path, jobs: int | None = None, fail_fast: bool = False, done: Done | None = None
) -> MatrixResults:
    """Run all cells and comparisons, each in its own folder below ``output``.

    The results stand in the order of the matrix, whatever the order of execution.

    Args:
        matrix: what to calibrate.
        output: the folder.
        jobs: processes; None for one a core.
        fail_fast: whether the first cell that fails stops the others.
        done: called after each job.

    Raises:
        InputError: a dataset, an evaluation or a truth is wrong; nothing has been calibrated then.
        WorldError: a process died.
    """
    loaded = {system.name: load(system) for system in matrix.systems}
    work: list[Job] = [*matrix.cells, *matrix.comparisons]
    order = sorted(range(len(work)), key=lambda i: isinstance(work[i], Cell))  # slow ones first
    results: dict[int, CellResult] = {}
    for place, result in in_parallel(partial(_run, loaded=loaded, output=output), [work[i] for i in order], jobs):
        index = order[place]
        results[index] = result
        if done:
            done(len(results), len(work), result)
        if fail_fast and isinstance(work[index], Cell) and result.verdict == "fail":
            break
    cells = tuple(results[i] for i, job in enumerate(work) if isinstance(job, Cell) and i in results)
    comparisons = tuple(results[i] for i, job in enumerate(work) if not isinstance(job, Cell) and i in results)
    return MatrixResults(cells, comparisons)


def load(system: System) -> LoadedSystem:
    """Read a system's data, and check what is to be done with it.

    Raises:
        InputError: the dataset, the truth, the evaluation or a method to compare with is wrong.
    """
    dataset = read_dataset(system.dataset)
    if system.truth is None:
        truth = find_truth(dataset)
    elif system.truth == "dataset":
        truth = truth_of(dataset)
    else:
        truth = None if system.truth == "none" else read_truth(Path(system.truth))
    for method in system.compare:
        if method not in METHODS:
            raise InputError(
                f"systems.{system.name}.compare: there is no method '{method}'{did_you_mean(method, METHODS)} "
                f"(known: {', '.join(METHODS)})"
            )
    evaluation = parse_evaluation(system.evaluate) if system.evaluate else None
    for sensor in (evaluation.source, evaluation.target) if evaluation else ():
        if sensor not in dataset.sensors:
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path} has no sensor '{sensor}'"
                f"{did_you_mean(sensor, dataset.sensors)} (sensors: {', '.join(dataset.sensors)})"
            )
    return LoadedSystem(system.name, dataset, truth, evaluation)


def _run(job: Job, loaded: dict[str, LoadedSystem], output: Path) -> CellResult:
    if isinstance(job, Cell):
        return run_cell(job, loaded[job.system], output)
    system, method = job
    return run_comparison(method, loaded[system], output)
