"""Admission of jobs: they start in order, as soon as the machine has free resources."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from calibration.ci.execution.job import Job


@dataclass(frozen=True)
class Need:
    """Resources that a job needs while it runs."""

    cores: float
    memory: int
    """Bytes; 0 if not specified."""

    @classmethod
    def of(cls, job: Job) -> Self:
        """Return the sum of a job's container limits; one core if no container has a limit."""
        limits = [container.limits for container in job.containers]
        return cls(sum(limit.cpus or 0.0 for limit in limits) or 1.0, sum(limit.memory or 0 for limit in limits))


class Admission:
    """Schedules the start of jobs. Thread-safe.

    A job that needs more than the whole machine starts when no other job runs: a limit is not its actual use.
    """

    def __init__(self, needs: Sequence[Need], cores: float, memory: int, workers: int | None = None) -> None:
        """Create a scheduler.

        Args:
            needs: needs of the jobs, in order.
            cores: cores of the machine; ignored if ``workers`` is given.
            memory: memory of the machine, bytes; 0 if unknown.
            workers: maximum number of concurrent jobs.
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
        """Wait for the next job that may start, and return its index; None after the last one, or when stopped."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._next >= len(self._needs) or self._next_job_fits())
            if self._stopped or self._next >= len(self._needs):
                return None
            index = self._next
            self._next += 1
            self._running.add(index)
            self._changed.notify_all()
            return index

    def release(self, index: int) -> None:
        """Report that a job has ended."""
        with self._changed:
            self._running.discard(index)
            self._changed.notify_all()

    def stop(self) -> None:
        """Prevent further jobs from starting."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _next_job_fits(self) -> bool:
        if not self._running:
            return True
        needs = [self._needs[index] for index in (*self._running, self._next)]
        return (
            len(needs) <= self._most
            and sum(need.cores for need in needs) <= self._cores
            and sum(need.memory for need in needs) <= self._memory
        )
