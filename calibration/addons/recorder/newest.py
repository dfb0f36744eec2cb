"""Background work on the newest request only; superseded requests are dropped."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Newest(Generic[Item]):
    """Worker thread with a queue of length one: a newer request replaces a waiting one."""

    def __init__(self, work: Callable[[Item], None], spare: Callable[[], bool] = lambda: False) -> None:
        """Start the thread.

        Args:
            work: called with a request. It must not raise: an error ends the thread.
            spare: called repeatedly while no request waits, until it returns False; then it is
                called again after the next request or `wake`.
        """
        self._work, self._spare = work, spare
        self._condition = threading.Condition()
        self._waiting: list[Item] = []  # one at most
        self._awake = True
        self._closed = False
        self._thread = threading.Thread(target=self._run_until_closed, name=f"newest {work.__name__}", daemon=True)
        self._thread.start()

    def ask(self, item: Item) -> None:
        """Request work on an item, in place of one that still waits."""
        with self._condition:
            self._waiting = [item]
            self._condition.notify()

    def wake(self) -> None:
        """Notify the thread of new spare work."""
        with self._condition:
            self._awake = True
            self._condition.notify()

    def close(self) -> None:
        """Stop the thread after its current work, and wait for it."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run_until_closed(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._waiting or self._awake or self._closed)
                if self._closed:
                    return
                items, self._waiting = self._waiting, []
                if not items:
                    self._awake = False
            for item in items:
                self._work(item)
            if self._spare():
                self.wake()
