"""A backend that runs nothing: it writes the jobs down as Kubernetes takes them."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from calibration.execution.backend import Done, RenderedError
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.batch.wire import check_run_name
from calibration.execution.docker.labels import new_run
from calibration.execution.job import Job
from calibration.execution.kubernetes.writing import write_rendering


class RenderingBackend:
    """A folder in the place of a cluster; a context manager, as other backends."""

    def __init__(self, settings: BatchSettings, run: str | None, folder: Path) -> None:
        """Choose a folder; nothing is written yet.

        Args:
            settings: as for AWS Batch.
            run: the name of the run; a new one unless given.
            folder: what `write_rendering` makes.

        Raises:
            InputError: the name cannot be part of others.
        """
        self.run_name = run if run is not None else new_run()
        check_run_name(self.run_name)
        self._settings = settings
        self._folder = folder

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End; there is nothing to end."""

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None, done: Done | None = None) -> NoReturn:
        """Write jobs down.

        Args:
            jobs: are not run.
            folder: is of no use here, as nothing is brought out.
            workers: is of no use here.
            done: is never called.

        Raises:
            RenderedError: they are written.
            InputError: a job makes no sense, or cannot run in a pod.
            WorldError: the folder cannot be written.
        """
        write_rendering(jobs, self._settings, self.run_name, self._folder)
        raise RenderedError(self._folder, self.run_name, len(jobs))
