"""Thread pool for requests to AWS."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Workers(Generic[Result]):
    """Runs functions in threads; results are returned in the order of completion.

    Safe against signals in the waiting thread: it waits on a queue, without a lock.
    """

    def __init__(self, count: int) -> None:
        self.waiting = 0
        """Number of functions whose result has not been returned."""
        self._work: SimpleQueue[Callable[[], Result] | None] = SimpleQueue()
        self._answers: SimpleQueue[Result | _Failure] = SimpleQueue()
        self._count = count
        self._stopping = False
        self._threads: list[threading.Thread] = []

    def give(self, work: Callable[[], Result]) -> None:
        """Submit a function."""
        self.waiting += 1
        self._work.put(work)
        if len(self._threads) < min(self._count, self.waiting):
            self._threads.append(threading.Thread(target=self._run_until_stopped, daemon=True))
            self._threads[-1].start()

    def take(self, seconds: float | None) -> list[Result]:
        """Wait for a result, at most this long (exactly, if none is due); return all that are available.

        Raises:
            BaseException: exception of a function.
        """
        if not self.waiting:
            time.sleep(seconds or 0.0)
        found: list[Result] = []
        while self.waiting:
            try:
                answer = self._answers.get(timeout=0.0 if found else seconds)
            except Empty:
                break
            self.waiting -= 1
            if isinstance(answer, _Failure):
                raise answer.error
            found.append(answer)
        return found

    def stop(self) -> None:
        """Start no more functions."""
        self._stopping = True
        for _ in self._threads:
            self._work.put(None)

    def join(self, seconds: float) -> None:
        """Wait for running functions, at most this long for each thread."""
        for thread in self._threads:
            thread.join(seconds)

    def _run_until_stopped(self) -> None:
        while not self._stopping and (work := self._work.get()) is not None:
            try:
                self._answers.put(work())
            except BaseException as error:  # any exception is passed to the waiting thread
                self._answers.put(_Failure(error))


def in_threads(count: int, work: Iterable[Callable[[], Result]], ahead: int = 1000) -> Iterator[Result]:
    """Run functions in a number of threads; yield results in the order of completion.

    Raises:
        BaseException: exception of a function; no more functions are started then.
    """
    workers: Workers[Result] = Workers(count)
    try:
        for piece in work:
            workers.give(piece)
            yield from workers.take(None if workers.waiting > ahead else 0.0)
        while workers.waiting:
            yield from workers.take(None)
    finally:
        workers.stop()


class _Failure:
    def __init__(self, error: BaseException) -> None:
        self.error = error
