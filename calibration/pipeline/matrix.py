"""The matrix: every system from every noisy start, in parallel over the cores."""

import ctypes
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from queue import SimpleQueue

from calibration.comparison.methods import METHODS
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import find_truth, read_truth, truth_of
from calibration.errors import InputError, WorldError
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.specification import parse_evaluation
from calibration.pipeline.cell import Cell, CellResult, LoadedSystem, run_cell, run_comparison
from calibration.pipeline.configuration import Loss, NoiseGrid, Start, System
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
    workers = min(jobs or _cores(), len(work))
    results: dict[int, CellResult] = {}
    for index, result in (
        _in_parallel(work, loaded, output, workers) if workers > 1 else _one_by_one(work, loaded, output)
    ):
        results[index] = result
        if done:
            done(len(results), len(work), result)
        if fail_fast and isinstance(work[index], Cell) and result.verdict == "fail":
            break
    cells = tuple(results[i] for i, job in enumerate(work) if isinstance(job, Cell) and i in results)
    comparisons = tuple(results[i] for i, job in enumerate(work) if not isinstance(job, Cell) and i in results)
    return MatrixResults(cells, comparisons)


def _cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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


def _run(job: Job, loaded: Mapping[str, LoadedSystem], output: Path) -> CellResult:
    if isinstance(job, Cell):
        return run_cell(job, loaded[job.system], output)
    system, method = job
    return run_comparison(method, loaded[system], output)


def _one_by_one(
    work: Sequence[Job], loaded: Mapping[str, LoadedSystem], output: Path
) -> Iterator[tuple[int, CellResult]]:
    for index, job in enumerate(work):
        yield index, _run(job, loaded, output)


PR_SET_PDEATHSIG = 1
"""Linux's request for a signal when the parent dies."""
_loaded: Mapping[str, LoadedSystem] = {}
"""In a worker: the systems, inherited from the parent."""


def _in_parallel(
    work: Sequence[Job], loaded: Mapping[str, LoadedSystem], output: Path, workers: int
) -> Iterator[tuple[int, CellResult]]:
    """Run jobs in processes that inherit the loaded systems; on any end, none of them is left."""
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(loaded,))
    try:
        # A queue, because a signal may strike while one waits on it: waiting on futures holds locks that the
        # pool's own thread needs to end.
        finished: SimpleQueue[Future[CellResult]] = SimpleQueue()
        running: dict[Future[CellResult], int] = {}
        waiting = iter(sorted(enumerate(work), key=lambda item: isinstance(item[1], Cell)))  # slow ones first

        def submit(count: int) -> None:
            for index, job in islice(waiting, count):
                future = pool.submit(_run_in_worker, job, output)
                running[future] = index
                future.add_done_callback(finished.put)

        submit(4 * workers)
        while running:
            future = finished.get()
            submit(1)
            yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        message = "a worker process died (killed, or out of memory); try fewer with jobs"
        raise WorldError(message) from error
    finally:
        # Workers end with the cell they are at, also after a signal: one that is killed while it answers
        # leaves half an answer in the pipe, for which the pool would wait for ever.
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(loaded: Mapping[str, LoadedSystem]) -> None:
    """In a worker: signals are the parent's to handle; if it is killed, the worker is too."""
    global _loaded
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    _loaded = loaded


def _run_in_worker(job: Job, output: Path) -> CellResult:
    return _run(job, _loaded, output)
