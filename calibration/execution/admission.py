"""Which job may start when: in their order, as soon as the machine has room."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from calibration.execution.job import Job


@dataclass(frozen=True)
class Need:
    """What a job takes of the machine while it runs."""

    cores: float
    memory: int
    """Bytes; 0 where nothing is said."""

    @classmethod
    def of(cls, job: Job) -> Self:
        """The sum of its containers' limits; one core where none has a limit."""
        limits = [container.limits for container in job.containers]
        return cls(sum(limit.cpus or 0.0 for limit in limits) or 1.0, sum(limit.memory or 0 for limit in limits))


class Admission:
    """Lets jobs start. Used by the threads that run them.

    A job that needs more than the whole machine starts when nothing else runs: a limit is not what it uses.
    """

    def __init__(self, needs: Sequence[Need], cores: float, memory: int, workers: int | None = None) -> None:
        """Set it up.

        Args:
            needs: of the jobs, in their order.
            cores: of the machine; nothing else counts them where ``workers`` is given.
            memory: of the machine, bytes; 0 where it is not known.
            workers: jobs at once.
        """
        self._needs = needs
        self._cores = float("inf") if workers is not None else cores
        self._memory = memory or float("inf")
        self._most = workers or len(needs)
        self._next = 0
        self._running: set[int] = set()
        self._stopped = False
        self._changed = threading.Condition()

    def wait(self) -> int | None:
        """Wait for the next job that may start; None when there is none any more, or it was stopped."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._next >= len(self._needs) or self._fits())
            if self._stopped or self._next >= len(self._needs):
                return None
            index = self._next
            self._next += 1
            self._running.add(index)
            self._changed.notify_all()
            return index

    def release(self, index: int) -> None:
        """Say that a job has ended."""
        with self._changed:
            self._running.discard(index)
            self._changed.notify_all()

    def stop(self) -> None:
        """Let no other job start."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _fits(self) -> bool:
        if not self._running:
            return True
        needs = [self._needs[index] for index in (*self._running, self._next)]
        return (
            len(needs) <= self._most
            and sum(need.cores for need in needs) <= self._cores
            and sum(need.memory for need in needs) <= self._memory
        )
