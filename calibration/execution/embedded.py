"""The backend for functions: processes over the cores of this machine."""

import os
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Embedded:
    """Runs functions in worker processes of this machine; a :class:`calibration.execution.backends.Backend`.

    The workers are forked, so a function may be a closure: they inherit it with the data that it holds. What it returns
    must pickle. An error that it raises is raised here.
    """

    def run(
        self, work: Sequence[Callable[[], Result]], folder: Path = Path(), workers: int | None = None
    ) -> Generator[tuple[int, Result]]:
        """Call each function; yields its index and what it returned, in the order in which they come.

        They are begun in their order. On any end, an interruption too, no process is left.

        Args:
            work: the functions.
            folder: is of no use here.
            workers: processes; None for one a core, 1 for none but this one.

        Raises:
            InfrastructureError: a process died.
        """
        count = min(workers or cores(), len(work))
        if count > 1:
            from calibration.execution.processes import in_processes  # slow to import, and one cell needs none

            yield from in_processes(work, count)
        else:
            for index, function in enumerate(work):
                yield index, function()
