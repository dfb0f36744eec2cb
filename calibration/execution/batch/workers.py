"""Threads that do small pieces of work, mostly waiting for AWS."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Workers(Generic[Result]):
    """Do work in the order in which it is given; answers come as they are ready.

    A signal may strike the thread that waits for answers: it waits on a queue, and holds no lock.
    """

    def __init__(self, count: int) -> None:
        self.waiting = 0
        """Pieces of work whose answer has not been taken."""
        self._work: SimpleQueue[Callable[[], Result] | None] = SimpleQueue()
        self._answers: SimpleQueue[Result | _Failure] = SimpleQueue()
        self._count = count
        self._stopping = False
        self._threads: list[threading.Thread] = []

    def give(self, work: Callable[[], Result]) -> None:
        """Have something done."""
        self.waiting += 1
        self._work.put(work)
        if len(self._threads) < min(self._count, self.waiting):
            self._threads.append(threading.Thread(target=self._run, daemon=True))
            self._threads[-1].start()

    def take(self, seconds: float | None) -> list[Result]:
        """Wait for an answer, for so long at most (or so long, where none is to come); all that are there by then.

        Raises:
            BaseException: what a piece of work has raised.
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
        """Begin nothing more."""
        self._stopping = True
        for _ in self._threads:
            self._work.put(None)

    def join(self, seconds: float) -> None:
        """Wait until what was begun is done, for so long at most for each thread."""
        for thread in self._threads:
            thread.join(seconds)

    def _run(self) -> None:
        while not self._stopping and (work := self._work.get()) is not None:
            try:
                self._answers.put(work())
            except BaseException as error:  # whatever it is, who waits has to know of it
                self._answers.put(_Failure(error))


def in_threads(count: int, work: Iterable[Callable[[], Result]], ahead: int = 1000) -> Iterator[Result]:
    """Do all of some work in so many threads; the answers as they come.

    Raises:
        BaseException: what a piece of work has raised; nothing more is begun then.
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
