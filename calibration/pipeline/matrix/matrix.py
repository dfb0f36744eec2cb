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

from calibration.base.tables.table import read_table
from calibration.base.tables.table_verdict import judge
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.ci.report import at_most
from calibration.engine.comparison import method_of
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.containers import Software
from calibration.pipeline.matrix.cell_result import OUR_METHOD, Cell, CellResult, Comparison, noise_folder
from calibration.pipeline.matrix.loaded_system import LoadedSystem, load
from calibration.pipeline.matrix.running_cell import run_cell, run_comparison
from calibration.pipeline.results import PipelineResults, without_verdicts
from calibration.pipeline.system import NoiseGrid, System

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
            for noise in (self._starting_noises if method_of(method).from_start else [None])
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


def judge_cells(cells: Sequence[CellResult], systems: Sequence[System], output: Path) -> tuple[CellResult, ...]:
    """Return the cells with the reasons to fail by their system's rules and limits.

    Raises:
        InputError: a rule names a column or a row that the table of a cell lacks.
    """
    by_name = {system.name: system for system in systems}
    return tuple(_judge_cell(cell, by_name[cell.system], output) for cell in cells)


def _judge_cell(cell: CellResult, system: System, output: Path) -> CellResult:
    if cell.error is not None:
        return cell
    reasons = list(_over_limits(cell, system.limits))
    if system.rules is not None:
        if cell.table is None:
            reasons.append("there is no table to judge")
        else:
            verdict = judge(read_table(output / cell.table), system.rules)
            reasons += [violation.message for violation in verdict.violations]
    return replace(cell, reasons=(*cell.reasons, *reasons), undecided_passes=system.undecided == "pass")


def _over_limits(cell: CellResult, limits: Limits) -> list[str]:
    """Return the limits that a cell exceeds; missing and infinite numbers do."""
    truth = cell.truth
    judged = [("RMS", cell.rms_px, limits.rms_px, "px")]
    if truth is not None:  # without truth, suspects and standard deviations are judged instead (`diagnosis`)
        judged += [
            ("translation error against the truth", truth.translation_mm, limits.translation_mm, "mm"),
            ("rotation error against the truth", truth.rotation_deg, limits.rotation_deg, "deg"),
            ("joint translation error against the truth", truth.joint_mm, limits.joint_mm, "mm"),
            ("joint rotation error against the truth", truth.joint_deg, limits.joint_deg, "deg"),
        ]
    judged += [(f"error of task '{e.name}' against the truth", e.truth, e.limit, e.unit) for e in cell.tasks if e.truth]
    checks = (at_most(what, value, limit, unit) for what, value, limit, unit in judged if limit is not None)
    return [str(check) for check in checks if not check.passed]


def judge_results(results: PipelineResults, systems: Sequence[System], output: Path) -> PipelineResults:
    """Return the results with the cells of some systems judged; those of others stay as they are.

    Our engine's references for a team's software are judged too, but do not count for the verdict.

    Args:
        results: of a run.
        systems: systems, with their rules and limits.
        output: its output folder.

    Raises:
        InputError: a rule does not match a table, or a table cannot be read.
    """
    names = {system.name for system in systems}
    fresh = without_verdicts(results)

    def judged(before: Sequence[CellResult], now: Sequence[CellResult]) -> tuple[CellResult, ...]:
        pairs = zip(before, now, strict=True)
        return tuple(
            judge_cells([cell], systems, output)[0] if cell.system in names and not cell.by_other_method else old
            for old, cell in pairs
        )

    return replace(
        fresh,
        cells=judged(results.cells, fresh.cells),
        comparisons=judged(results.comparisons, fresh.comparisons),
    )
