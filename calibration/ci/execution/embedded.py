"""Backend for functions: worker processes on this machine."""

import os
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")


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
            from calibration.ci.execution.processes import in_processes  # slow to import, and not needed for one cell

            yield from in_processes(work, count)
        else:
            for index, function in enumerate(work):
                yield index, function()
