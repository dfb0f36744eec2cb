"""The same work on many items, in processes over the cores of this machine."""

import ctypes
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from queue import SimpleQueue
from typing import Any, TypeVar

from calibration.errors import WorldError
from calibration.workflow.signals import held_back

Item = TypeVar("Item")
Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1
"""Linux's request for a signal when the parent dies."""
_work: Callable[[Any], Any] | None = None
"""In a worker: the work, inherited from the parent with all that it holds."""


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Iterator[tuple[int, Result]]:
    """Do the work on every item; yields the item's index and the result, in the order in which they come.

    Items are begun in their order. On any end, an interruption too, no process is left.

    Args:
        work: may be a closure: the workers inherit it. An error that it raises is raised here.
        items: and the results, must pickle.
        workers: processes; None for one a core, 1 for none but this one.

    Raises:
        WorldError: a process died.
    """
    count = min(workers or cores(), len(items))
    if count > 1:
        yield from _in_processes(work, items, count)
    else:
        for index, item in enumerate(items):
            yield index, work(item)


def _in_processes(work: Callable[[Item], Result], items: Sequence[Item], workers: int) -> Iterator[tuple[int, Result]]:
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(work,))
    try:
        # A queue, because a signal may strike while one waits on it: waiting on futures holds locks that the
        # pool's own thread needs to end.
        finished: SimpleQueue[Future[Result]] = SimpleQueue()
        running: dict[Future[Result], int] = {}
        waiting = iter(enumerate(items))

        def submit(count: int) -> None:
            for index, item in islice(waiting, count):
                with held_back():  # the first of them forks the workers
                    future = pool.submit(_run_in_worker, item)
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
        # Workers end with the item they are at, also after a signal: one that is killed while it answers
        # leaves half an answer in the pipe, for which the pool would wait for ever.
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(work: Callable[[Any], Any]) -> None:
    """In a worker: signals are the parent's to handle; if it is killed, the worker is too."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    _work = work


def _run_in_worker(item: Any) -> Any:
    if _work is None:
        raise AssertionError("a worker begins with _begin")
    return _work(item)
