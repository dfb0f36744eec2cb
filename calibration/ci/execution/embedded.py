"""Backend for functions: worker processes on this machine, forked."""

import ctypes
import mmap
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from calibration.base import ExitCode, InfrastructureError
from calibration.base.process import held_back

Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1
"""Linux's prctl option for a signal when the parent dies."""
POOL_THREADS_BYTES = 64 << 20
"""Bytes of address space: the stacks of the pool's two threads (8 MB each), their heaps, and some more."""
BATCH_SECONDS = 0.03
"""Seconds of work in a batch, the functions that a worker is sent at once; after a signal it finishes its batch."""
MOST_IN_BATCH = 16
"""Most functions in a batch: one worker may have the last batch while the others have nothing left to do."""
_work: Sequence[Callable[[], Any]] = ()
"""The functions to call, set in a worker only: inherited from the parent with the data that they reference."""


def in_processes(work: Sequence[Callable[[], Result]], workers: int) -> Generator[tuple[int, Result]]:
    """Call each function in a worker process; see `calibration.ci.execution.embedded.Embedded.run`."""
    with single_threaded_opencv():
        yield from _in_forked_processes(work, workers)


def _in_forked_processes(work: Sequence[Callable[[], Result]], workers: int) -> Generator[tuple[int, Result]]:
    _require_room_for_threads()
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_initialise_worker, initargs=(work, os.getpid()))
    try:
        # A queue, because a signal may interrupt waiting on it: waiting on futures holds locks that the
        # pool's own thread needs to end.
        finished: SimpleQueue[Future[list[Result]]] = SimpleQueue()
        running: dict[Future[list[Result]], tuple[int, ...]] = {}
        waiting = iter(range(len(work)))
        pace = _Pace(workers)

        def submit() -> None:
            if batch := tuple(islice(waiting, pace.batch_size())):
                with held_back():  # the first submission forks the workers
                    future = pool.submit(_run_in_worker, batch)
                running[future] = batch
                future.add_done_callback(finished.put)

        for _ in range(4 * workers):
            submit()
        while running:
            future = finished.get()
            batch = running.pop(future)
            pace.finished += len(batch)
            submit()
            yield from zip(batch, future.result(), strict=True)
    except BrokenProcessPool as error:
        message = "a worker process died (killed, or out of memory); try fewer with jobs"
        raise InfrastructureError(message) from error
    finally:
        # Workers finish their current batch, also after a signal: one that is killed while it writes its result
        # leaves a partial message in the pipe, and the pool would wait for the rest. A second signal is delayed too:
        # an interrupted shutdown leaves workers running, and Python would wait for them at exit.
        with held_back():
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def single_threaded_opencv() -> Iterator[None]:
    """Limit OpenCV, where it is loaded, to one thread: its threads do not survive a fork, OpenCV 5 waits for them."""
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        yield
        return
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


class _Pace:
    """Pace of the workers, by which batches are sized: sending takes as long as a cell of a small matrix."""

    def __init__(self, workers: int) -> None:
        """Begin measuring so many workers."""
        self._workers, self._initialise_worker = workers, time.monotonic()
        self.finished = 0
        """Number of functions that have returned."""

    def batch_size(self) -> int:
        """Return how many functions take about `BATCH_SECONDS`, by the mean time so far; 1 before any has returned."""
        if not self.finished:
            return 1
        seconds = (time.monotonic() - self._initialise_worker) * self._workers / self.finished
        return MOST_IN_BATCH if seconds * MOST_IN_BATCH < BATCH_SECONDS else max(1, int(BATCH_SECONDS / seconds))


def _require_room_for_threads() -> None:
    """Check the memory for the pool's own threads: without them the workers would never receive a request to end.

    Raises:
        MemoryError: the free memory is less than the stacks of these threads.
    """
    try:
        mmap.mmap(-1, POOL_THREADS_BYTES).close()
    except OSError:
        raise MemoryError from None


def _initialise_worker(work: Sequence[Callable[[], Any]], parent: int) -> None:
    """Initialise a worker: the parent handles signals; if it is killed, the worker is killed too."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it was killed before the worker could ask for the signal
        os._exit(ExitCode.INFRASTRUCTURE)
    _work = work


def _run_in_worker(batch: Sequence[int]) -> list[Any]:
    return [_work[index]() for index in batch]


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Embedded:
    """Runs functions in worker processes of this machine; a :class:`calibration.ci.execution.backends.Backend`.

    Workers are forked, so functions may be closures, whose data they inherit. Return values must be
    picklable. Exceptions of a function are raised here.
    """

    def run(
        self, work: Sequence[Callable[[], Result]], folder: Path = Path(), workers: int | None = None
    ) -> Generator[tuple[int, Result]]:
        """Call each function; yield index and return value, in the order of completion.

        Functions are started in order. All processes have ended when this returns, also after an interruption.

        Args:
            work: the functions.
            folder: ignored.
            workers: number of processes; None for one per core, 1 for the current process only.

        Raises:
            InfrastructureError: a process died.
        """
        count = min(workers or cores(), len(work))
        if count > 1:
            yield from in_processes(work, count)
        else:
            for index, function in enumerate(work):
                yield index, function()
