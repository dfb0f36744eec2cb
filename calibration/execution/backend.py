"""What every backend of the job model can do."""

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Protocol

from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome

Done = Callable[[int, JobOutcome], None]
"""Called after each job, in the order of completion, with the job's index and what came of it."""


class Backend(Protocol):
    """Where jobs run."""

    def run(
        self, jobs: Sequence[Job], folder: Path, workers: int | None = None, done: Done | None = None
    ) -> Generator[tuple[int, JobOutcome]]:
        """Run jobs; yields each one's index and what came of it, in the order of completion.

        Closing the iterator, or any exception in whoever reads it, stops and removes everything.

        Args:
            jobs: are started in their order.
            folder: each job has its own in it, by its name; what an earlier run left in that is removed.
            workers: jobs at once; None for as many as the machine holds.
            done: called before each is yielded.

        Raises:
            InputError: a job makes no sense, or an image is missing; nothing has been started then.
            WorldError: the backend cannot be reached, or a file not be written.
        """
        ...
