"""Backends: what runs work, and how one is chosen by its name."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, TypeVar

from calibration.errors import InputError
from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome
from calibration.workflow.streams import LogDisplay
from calibration.workflow.text import did_you_mean

Work = TypeVar("Work", contravariant=True)
Outcome = TypeVar("Outcome", covariant=True)


class Backend(Protocol[Work, Outcome]):
    """Runs work of one kind: functions in processes (`calibration.execution.embedded`), or jobs of containers."""

    def run(self, work: Sequence[Work], /, folder: Path, workers: int | None = None) -> Generator[tuple[int, Outcome]]:
        """Run work; yields each one's index and what came of it, in the order of completion.

        What is wrong with the work is raised by this call; nothing is started before the first outcome is asked
        for. Closing the iterator, or any exception in whoever reads it, stops and removes everything.

        Args:
            work: is started in its order.
            folder: each job of containers has its own in it, by its name; what an earlier run left in that is removed.
            workers: at once; None for as many as the backend holds.

        Raises:
            InputError: a job makes no sense, or an image is missing.
            WorldError: the backend cannot be reached, a process died, or a file cannot be written.
        """
        ...


JobBackend = Backend[Job, JobOutcome]


@dataclass(frozen=True)
class BackendKind:
    """A backend for jobs as it is registered; its modules are imported when it is opened."""

    target: str
    """``module:callable``, which makes the backend, a context manager, of a `Place`."""
    section: str = ""
    """The key of calibration.yml with the backend's settings; empty where it needs none."""
    settings: str = ""
    """``module:callable``, which reads the settings from a file that has the section."""
    resumes: bool = False
    """Whether what a run leaves there outlives the command: a run of the same name takes it and runs the rest."""


EMBEDDED = "embedded"
"""Functions of ours, in processes of this machine."""
DOCKER, AWS_BATCH = "docker", "aws-batch"
KINDS: Mapping[str, BackendKind] = {
    DOCKER: BackendKind("calibration.execution.docker.backend:open_docker"),
    AWS_BATCH: BackendKind(
        "calibration.execution.batch.backend:open_batch",
        section="aws-batch",
        settings="calibration.execution.batch.settings:read_section",
        resumes=True,
    ),
}
"""The backends for jobs of containers, by their names; one more is registered here."""
CONTAINERS = tuple(KINDS)
BACKENDS = (EMBEDDED, *CONTAINERS)


def check_backend(name: str, known: tuple[str, ...] = BACKENDS) -> None:
    """Refuse a backend that there is not.

    Raises:
        InputError: naming those that there are.
    """
    if name not in known:
        expected = f"{', '.join(known[:-1])} or {known[-1]}"
        raise InputError(f"backend: found '{name}', expected {expected}{did_you_mean(name, known)}")


@dataclass(frozen=True)
class Place:
    """Where jobs of containers run."""

    backend: str = DOCKER
    """One of `KINDS`."""
    settings: Any = None
    """What the backend's section of calibration.yml says."""
    run: str | None = None
    """The name of the run; a new one unless given."""
    resume: bool = False
    """Whether results of an earlier run of this name are taken, and only what is missing is run."""
    show: LogDisplay | None = None
    """Where the logs of the containers are shown."""

    def open(self) -> AbstractContextManager[JobBackend]:
        """Make the backend, which is looked for when it is entered.

        Raises:
            InputError: its section is missing, or the name of the run is wrong.
        """
        kind = KINDS[self.backend]
        if kind.section and self.settings is None:
            raise InputError(
                f"backend: found {self.backend}, but nothing says where: expected a section {kind.section} in "
                "calibration.yml, or a file with one"
            )
        backend: AbstractContextManager[JobBackend] = imported(kind.target)(self)
        return backend


def read_settings(backend: str, path: Path) -> object:
    """Read the settings of a backend that has a section of its own.

    Raises:
        InputError: the file or the section is missing, or it is wrong; names file and key.
    """
    settings: object = imported(KINDS[backend].settings)(path)
    return settings


def imported(target: str) -> Any:
    """What ``module:attribute`` names."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)
