"""Matrix run: every system from every noisy initial guess, in parallel.

A team's own software calibrates the cells of its system, and our engine calibrates the
same data from the same initial guesses as a comparison, to distinguish "our software got worse" from "the data
got worse".
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base import InputError, did_you_mean
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset, refuse_changes
from calibration.engine.diagnosis.copies import without_copies
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.estimation.start.lens_choice import with_chosen_lenses
from calibration.engine.evaluation.truth import choose_truth
from calibration.engine.tasks.placed_task import frames_of_task
from calibration.engine.tasks.robot_task import RobotTask
from calibration.pipeline.matrix.cell_result import OUR_METHOD, Cell, CellResult, Comparison, noise_folder
from calibration.pipeline.matrix.cell_verdict import check_rules
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.running_cell import other_method, run_cell, run_comparison
from calibration.pipeline.matrix.software import Software
from calibration.pipeline.system import NoiseGrid, System

if TYPE_CHECKING:
    from calibration.engine.evaluation.specification import Evaluation

Done = Callable[[int, int, CellResult], None]
"""Callback after each task: number of finished tasks, number of all tasks, result."""


@dataclass(frozen=True)
class Matrix:
    """Systems, noise and methods of a matrix."""

    systems: tuple[System, ...]
    noise: NoiseGrid

    @property
    def cells(self) -> list[Cell]:
        """Cells of all combinations, system by system."""
        return [
            Cell(system.name, noise, system.options.start, system.options.loss)
            for system in self.systems
            for noise in self._starting_noises
        ]

    @property
    def software(self) -> dict[str, Software]:
        """The team's own software, by system."""
        return {system.name: system.software for system in self.systems if system.software is not None}

    @property
    def comparisons(self) -> list[Comparison]:
        """Comparisons with each method on each system; of a method that uses an initial guess, one for each guess.

        Raises:
            InputError: there is no such method.
        """
        return [
            Comparison(system.name, method, noise)
            for system in self.systems
            for method in system.compare
            for noise in (self._starting_noises if other_method(method).from_start else [None])
        ]

    @property
    def _starting_noises(self) -> list[StartingNoise]:
        n = self.noise
        return [StartingNoise(t, r, seed) for t in n.translations for r in n.rotations for seed in n.seeds]


@dataclass(frozen=True)
class MatrixResults:
    """Results of a matrix; cells that did not run, because another one failed, are missing."""

    cells: tuple[CellResult, ...]
    comparisons: tuple[CellResult, ...]
    datasets: Mapping[str, Dataset]
    """The datasets that were calibrated, by system."""


def run_matrix(
    matrix: Matrix,
    output: Path,
    jobs: int | None = None,
    fail_fast: bool = False,
    done: Done = lambda *_: None,
    target: ExecutionTarget | None = None,
) -> MatrixResults:
    """Run all cells and comparisons, each in its own folder below ``output``.

    The results are in the order of the matrix, whatever the order of execution.

    Args:
        matrix: the cells.
        output: the output folder.
        jobs: number of parallel processes or containers; None for as many as the machine can run.
        fail_fast: whether the first cell that fails stops the others.
        done: called after each task.
        target: execution target of the containers; by default this machine's engine.

    Raises:
        InputError: a dataset, an evaluation, a truth or an image is wrong; raised before any calibration.
        InfrastructureError: a process died, or containers cannot be run.
    """
    with matrix_tasks(matrix, output, output) as tasks:
        cells = {task.name for task in tasks.cells}
        found = run_tasks(
            [*tasks.comparisons, *tasks.cells, *tasks.references],  # slow ones first
            output,
            jobs,
            target,
            done=done,
            stops=lambda name, result: fail_fast and name in cells and result.verdict == "fail",
        )

    def results(of: Sequence[Task[CellResult]]) -> tuple[CellResult, ...]:
        return tuple(found[task.name] for task in of if task.name in found)

    comparisons = (*results(tasks.references), *results(tasks.comparisons))
    return MatrixResults(results(tasks.cells), comparisons, tasks.datasets)


@dataclass(frozen=True)
class MatrixTasks:
    """Tasks of a matrix, each kind in the matrix's order."""

    cells: list[Task[CellResult]]
    references: list[Task[CellResult]]
    """Our engine on the cells of the team's software."""
    comparisons: list[Task[CellResult]]
    datasets: Mapping[str, Dataset]
    """The datasets that they calibrate, by system."""


@contextmanager
def matrix_tasks(matrix: Matrix, output: Path, containers: Path) -> Iterator[MatrixTasks]:
    """Create the tasks of a matrix; the files that containers read exist inside the ``with`` block.

    Args:
        matrix: the cells; its data are read.
        output: the folder of our engine's and other methods' files.
        containers: the folder of the jobs.

    Raises:
        InputError: a dataset, an evaluation, a truth or a command is wrong.
        InfrastructureError: a file cannot be written.
    """
    loaded = {system.name: load(system) for system in matrix.systems}
    comparisons = [
        Task.call(each.folder, partial(run_comparison, each, loaded[each.system], output))
        for each in matrix.comparisons
    ]
    datasets = {name: system.dataset for name, system in loaded.items()}
    with _software_tasks(matrix, loaded, containers) as theirs:
        cells, references = [], []
        for cell in matrix.cells:
            system = loaded[cell.system]
            if cell.system not in matrix.software:
                cells.append(Task.call(cell.folder, partial(run_cell, cell, system, output)))
                continue
            cells.append(theirs[cell])
            folder = f"{cell.system}/{OUR_METHOD}/{noise_folder(cell.noise)}"  # next to those of the cells
            references.append(Task.call(folder, partial(run_cell, cell, system, output, folder)))
        yield MatrixTasks(cells, references, comparisons, datasets)


def _software_tasks(
    matrix: Matrix, loaded: Mapping[str, LoadedSystem], output: Path
) -> AbstractContextManager[Mapping[Cell, Task[CellResult]]]:
    """Create the tasks of the cells that a team's software calibrates; see `software_tasks`."""
    if not matrix.software:
        return nullcontext({})
    from calibration.pipeline.matrix.software_cell import software_tasks  # most matrices have none

    return software_tasks(matrix.cells, loaded, matrix.software, output)


def load(system: System) -> LoadedSystem:
    """Read a system's data, and check its options.

    Raises:
        InputError: the dataset, the truth, the evaluation, a rule for its table, a comparison method or the
            covariance of intrinsics is wrong; no lens model fits a camera.
    """
    dataset, copies = read_dataset(system.dataset), tuple[Finding, ...]()
    if system.copies == "leave-out" and system.software is None:  # which is given the folder with all collections
        dataset, copies = without_copies(dataset)
    lenses = with_chosen_lenses(dataset, system.options)
    dataset = lenses.dataset
    truth = choose_truth(dataset, system.truth)
    _check_methods(system)
    evaluation = _evaluation_from(system.evaluate) if system.evaluate else None
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
    tasks = _known_tasks(system, dataset)
    options = replace(system.options, intrinsics_covariance=system.options.known_intrinsics())
    loaded = LoadedSystem(
        system.name,
        dataset,
        truth,
        evaluation,
        options,
        system.judging_limits,
        tasks,
        system.datasets,
        system.accepted,
        copies,
        lenses.choices,
        system.exports,
    )
    if system.datasets == "changes":
        refuse_changes(system.dataset, dataset.path)
        loaded.writer.reference  # noqa: B018 (of the bytes that were read)
    if system.datasets == "none" and system.exports is not None:
        raise InputError(f"systems.{system.name}.datasets: found none, expected changes or full: it has exports")
    loaded.check()  # before the fork, so that all cells share the result
    if system.rules is not None and system.software is None:  # other software's table may have any columns
        check_rules(system.rules, loaded)
    return loaded


def _evaluation_from(text: str) -> "Evaluation":
    """Parse a system's table; see `parse_evaluation`."""
    from calibration.engine.evaluation.specification import parse_evaluation  # with the modules of all kinds of tables

    return parse_evaluation(text)


def _known_tasks(system: System, dataset: Dataset) -> tuple[RobotTask, ...]:
    """Return the tasks of a system, with the poses of their joints.

    Raises:
        InputError: the dataset does not have a task's sensors or frames, or the robot not its joints.
    """
    tasks = []
    for task in system.tasks:
        try:
            if task.joints is not None:
                # with the simulation; most tasks have none
                from calibration.pipeline.matrix.described_robot import described_robot, work_poses

                robot = described_robot(dataset.path.parent, system.exports)
                task = replace(task, work_poses=work_poses(task, dataset, robot))
            frames_of_task(dataset, task)
        except InputError as error:
            raise InputError(f"systems.{system.name}.{error}") from None
        tasks.append(task)
    return tuple(tasks)


def _check_methods(system: System) -> None:
    """Refuse comparison methods that there are not.

    Raises:
        InputError: there is one.
    """
    for method in system.compare:
        try:
            other_method(method)
        except InputError as error:
            raise InputError(f"systems.{system.name}.compare: {error}") from None
