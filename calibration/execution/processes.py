"""Worker processes that are forked: apart, since what they need takes as long to import as a cell to calibrate."""

import ctypes
import multiprocessing
import signal
import sys
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from queue import SimpleQueue
from typing import Any, TypeVar

from calibration.errors import InfrastructureError
from calibration.workflow.signals import held_back

Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1
"""Linux's request for a signal when the parent dies."""
_work: Sequence[Callable[[], Any]] = ()
"""In a worker: the functions, inherited from the parent with all that they hold."""


def in_processes(work: Sequence[Callable[[], Result]], workers: int) -> Generator[tuple[int, Result]]:
    """Call each function in one of so many workers; see `calibration.execution.embedded.Embedded.run`."""
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(work,))
    try:
        # A queue, because a signal may strike while one waits on it: waiting on futures holds locks that the
        # pool's own thread needs to end.
        finished: SimpleQueue[Future[Result]] = SimpleQueue()
        running: dict[Future[Result], int] = {}
        waiting = iter(range(len(work)))

        def submit(count: int) -> None:
            for index in islice(waiting, count):
                with held_back():  # the first of them forks the workers
                    future = pool.submit(_run_in_worker, index)
                running[future] = index
                future.add_done_callback(finished.put)

        submit(4 * workers)
        while running:
            future = finished.get()
            submit(1)
            yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        message = "a worker process died (killed, or out of memory); try fewer with jobs"
        raise InfrastructureError(message) from error
    finally:
        # Workers end with the item they are at, also after a signal: one that is killed while it answers
        # leaves half an answer in the pipe, for which the pool would wait for ever. A second signal waits for them too:
        # a shutdown that is broken off leaves workers that nobody tells to end, and Python waits for them.
        with held_back():
            pool.shutdown(wait=True, cancel_futures=True)


def _begin(work: Sequence[Callable[[], Any]]) -> None:
    """In a worker: signals are the parent's to handle; if it is killed, the worker is too."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    _work = work


def _run_in_worker(index: int) -> Any:
    return _work[index]()
