"""The matrix: every system from every noisy start, in parallel over the cores.

Where a system has software of the team's own, that calibrates its cells, and our engine calibrates the
same data from the same starts as a comparison, so that "our software got worse" and "the data got worse"
can be told apart.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from calibration.comparison.methods import METHODS, method_of
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import choose_truth
from calibration.errors import InputError
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.specification import parse_evaluation
from calibration.execution.backends import Place
from calibration.execution.tasks import Task, run_tasks
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
from calibration.pipeline.matrix.judgement import check_rules
from calibration.pipeline.matrix.software import Software
from calibration.pipeline.matrix.software_cell import software_task
from calibration.pipeline.system import NoiseGrid, System
from calibration.workflow.text import did_you_mean

Done = Callable[[int, int, CellResult], None]
"""Called after each task with how many are done, how many there are, and its result."""


@dataclass(frozen=True)
class Matrix:
    """What is to be calibrated."""

    systems: tuple[System, ...]
    noise: NoiseGrid

    @property
    def cells(self) -> list[Cell]:
        """Every combination, system by system."""
        return [
            Cell(system.name, noise, system.options.start, system.options.loss)
            for system in self.systems
            for noise in self._starts
        ]

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
    done: Done = lambda *_: None,
    place: Place | None = None,
) -> MatrixResults:
    """Run all cells and comparisons, each in its own folder below ``output``.

    The results stand in the order of the matrix, whatever the order of execution.

    Args:
        matrix: what to calibrate.
        output: the folder.
        jobs: processes, or containers at once; None for as many as the machine holds.
        fail_fast: whether the first cell that fails stops the others.
        done: called after each task.
        place: where containers run; this machine's engine unless given.

    Raises:
        InputError: a dataset, an evaluation, a truth or an image is wrong; nothing has been calibrated then.
        InfrastructureError: a process died, or containers cannot be run.
    """
    with matrix_tasks(matrix, output, output) as tasks:
        cells = {task.name for task in tasks.cells}
        found = run_tasks(
            [*tasks.comparisons, *tasks.cells, *tasks.references],  # slow ones first
            output,
            jobs,
            place,
            done=done,
            stops=lambda name, result: fail_fast and name in cells and result.verdict == "fail",
        )

    def results(of: Sequence[Task[CellResult]]) -> tuple[CellResult, ...]:
        return tuple(found[task.name] for task in of if task.name in found)

    return MatrixResults(results(tasks.cells), (*results(tasks.references), *results(tasks.comparisons)))


@dataclass(frozen=True)
class MatrixTasks:
    """The tasks of a matrix, each kind in the matrix's order."""

    cells: list[Task[CellResult]]
    references: list[Task[CellResult]]
    """Our engine on what a cell has the team's software calibrate."""
    comparisons: list[Task[CellResult]]


@contextmanager
def matrix_tasks(matrix: Matrix, output: Path, containers: Path) -> Iterator[MatrixTasks]:
    """The tasks of a matrix; what jobs in containers read is there inside the block.

    Args:
        matrix: what to calibrate; its data are read.
        output: the folder of what our engine and other methods leave.
        containers: the folder of the jobs.

    Raises:
        InputError: a dataset, an evaluation or a truth is wrong, or a command.
        InfrastructureError: a file cannot be written.
    """
    loaded = {system.name: load(system) for system in matrix.systems}
    comparisons = [
        Task.call(each.folder, partial(run_comparison, each, loaded[each.system], output))
        for each in matrix.comparisons
    ]
    cells, references = [], []
    with ExitStack() as stack:
        starts = containers
        if matrix.software:
            containers.mkdir(parents=True, exist_ok=True)
            starts = Path(stack.enter_context(TemporaryDirectory(prefix=".starts-", dir=containers)))
        for number, cell in enumerate(matrix.cells):
            system = loaded[cell.system]
            if cell.system not in matrix.software:
                cells.append(Task.call(cell.folder, partial(run_cell, cell, system, output)))
                continue
            software = matrix.software[cell.system]
            cells.append(software_task(cell, system, software, starts / str(number), containers))
            folder = f"{cell.system}/{OUR_METHOD}/{noise_folder(cell.noise)}"  # beside those of the cells
            references.append(Task.call(folder, partial(run_cell, cell, system, output, folder)))
        yield MatrixTasks(cells, references, comparisons)


def load(system: System) -> LoadedSystem:
    """Read a system's data, and check what is to be done with it.

    Raises:
        InputError: the dataset, the truth, the evaluation, a rule for its table, a method to compare with or what is
            known of intrinsics is wrong.
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
        if missing := sensor not in dataset.sensors and dataset.missing_files_of(sensor):
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path}: {missing}; put them beside it, or evaluate other sensors"
            )
        if sensor not in dataset.sensors:
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path} has no sensor '{sensor}'"
                f"{did_you_mean(sensor, dataset.sensors)} (sensors: {', '.join(dataset.sensors)})"
            )
    options = replace(system.options, intrinsics_covariance=system.options.known_intrinsics())
    loaded = LoadedSystem(system.name, dataset, truth, evaluation, options, system.limits, system.accepted)
    loaded.check()  # here, so that cells that are forked know it
    if system.rules is not None and system.software is None:  # whose table may have any columns
        check_rules(system.rules, loaded)
    return loaded
