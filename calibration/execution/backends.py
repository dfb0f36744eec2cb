"""Backends: what runs work, how one is chosen by its name, and all that the rest of the package knows of it.

A backend for jobs is an entry of `KINDS`: what makes it, its section of calibration.yml, and what removes what killed
runs have left there.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

from calibration.errors import InputError
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome
from calibration.records import field, flat_fields, read, record
from calibration.variables import with_variables
from calibration.workflow.streams import LogDisplay
from calibration.workflow.text import did_you_mean
from calibration.yaml_file import read_yaml

if TYPE_CHECKING:
    from calibration.execution.docker.labels import Owner

Work = TypeVar("Work", contravariant=True)
Outcome = TypeVar("Outcome", covariant=True)


class Leftover(Protocol):
    """Something that a run has started and not removed."""

    @property
    def owner(self) -> "Owner | None":
        """The process that started it; None where nothing says which."""

    @property
    def row(self) -> tuple[str, ...]:
        """What a table says of it."""


Left = TypeVar("Left", bound=Leftover)


class Leftovers(AbstractContextManager[Any], Protocol[Left]):
    """Finds and removes what runs have left in a backend."""

    header: tuple[str, ...]
    """Of the rows."""

    def find(self, run: str | None) -> Sequence[Left]:
        """What a run, or every run, has left, in the order in which it can be removed."""

    def remove(self, chosen: Sequence[Left]) -> None:
        """Remove it; what is gone already is no error."""

    def told(self, chosen: Sequence[Left], dry_run: bool) -> str:
        """What has been removed, or would be, in one line."""


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
            InfrastructureError: the backend cannot be reached, a process died, or a file cannot be written.
        """
        ...


JobBackend = Backend[Job, JobOutcome]


@dataclass(frozen=True)
class BackendKind:
    """A backend for jobs as it is registered; its modules are imported when it is opened."""

    target: str
    """``module:callable``, which makes the backend, a context manager, of a `Place`."""
    leftovers: str
    """``module:callable``, which makes its `Leftovers`."""
    settings: Any = None
    """The record of its section of calibration.yml, which is called as the backend; None where it needs none."""
    resumes: bool = False
    """Whether what a run leaves there outlives the command: a run of the same name takes it and runs the rest."""


EMBEDDED = "embedded"
"""Functions of ours, in processes of this machine."""
DOCKER, AWS_BATCH = "docker", "aws-batch"
KINDS: Mapping[str, BackendKind] = {
    DOCKER: BackendKind(
        "calibration.execution.docker.backend:open_docker", "calibration.execution.docker.leftovers:EngineLeftovers"
    ),
    AWS_BATCH: BackendKind(
        "calibration.execution.batch.backend:open_batch",
        "calibration.execution.batch.leftovers:open_leftovers",
        settings=BatchSettings,
        resumes=True,
    ),
}
"""The backends for jobs of containers, by their names; one more is registered here."""
CONTAINERS = tuple(KINDS)
BACKENDS = (EMBEDDED, *CONTAINERS)
ContainerBackend = Literal["docker", "aws-batch"]
BackendName = Literal["embedded", "docker", "aws-batch"]


@record
class Sections:
    """Settings of backends, each in the section of calibration.yml that is called as the backend."""

    aws_batch: BatchSettings | None = field("Where in AWS containers run that are to run there.", default=None)

    def of(self, backend: str) -> Any:
        """Settings of a backend; None where the file has no section of it."""
        return getattr(self, backend.replace("-", "_"), None)


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
    sections: Sections = dataclass_field(default_factory=Sections)
    """Of calibration.yml, with that of the backend."""
    run: str | None = None
    """The name of the run; a new one unless given."""
    resume: bool = False
    """Whether results of an earlier run of this name are taken, and only what is missing is run."""
    show: LogDisplay | None = None
    """Where the logs of the containers are shown."""

    @property
    def settings(self) -> Any:
        """Settings of the backend; None where there are none."""
        return self.sections.of(self.backend)

    def open(self) -> AbstractContextManager[JobBackend]:
        """Make the backend, which is looked for when it is entered.

        Raises:
            InputError: its section is missing, or the name of the run is wrong.
        """
        kind = KINDS[self.backend]
        if kind.settings and self.settings is None:
            raise InputError(
                f"backend: found {self.backend}, but nothing says where: expected a section {self.backend} in "
                "calibration.yml, or a file with one"
            )
        backend: AbstractContextManager[JobBackend] = imported(kind.target)(self)
        return backend


def read_sections(backend: str, path: Path) -> Sections:
    """Read the section of a backend from a file; ``${NAME}`` in it is replaced by the environment variable.

    Raises:
        InputError: the file or the section is missing, or it is wrong; names file and key.
    """
    kind = KINDS[backend].settings
    document = read_yaml(path, f"a file with a section {backend}")
    if not isinstance(document, dict) or backend not in document:
        required = ", ".join(key for key, each in flat_fields(kind).items() if each.required)
        raise InputError(f"{path}: missing {backend}: {required}")
    where = f"{path}: {backend}"
    return Sections(**{backend.replace("-", "_"): read(kind, with_variables(document[backend], where), where)})


def imported(target: str) -> Any:
    """What ``module:attribute`` names."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)
