"""Registry of backends, and their interface for the rest of the package.

A backend for jobs is an entry of `KINDS`: its factory, its section of calibration.yml, and the removal of leftovers
of killed runs.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

from calibration.addons.aws_batch.settings import BatchSettings
from calibration.base.errors import InputError
from calibration.base.records import field, flat_fields, read, record
from calibration.base.text import did_you_mean
from calibration.base.variables import with_variables
from calibration.base.yaml_file import read_yaml
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.workflow.streams import LogDisplay

if TYPE_CHECKING:
    from calibration.ci.execution.docker.labels import Owner

Work = TypeVar("Work", contravariant=True)
Outcome = TypeVar("Outcome", covariant=True)


class Leftover(Protocol):
    """An object that a run has created and not removed."""

    @property
    def owner(self) -> "Owner | None":
        """Process that created it; None if unknown."""

    @property
    def row(self) -> tuple[str, ...]:
        """Cells of a table's row."""


Left = TypeVar("Left", bound=Leftover)


class Leftovers(AbstractContextManager[Any], Protocol[Left]):
    """Search and removal of leftovers of runs in a backend."""

    header: tuple[str, ...]
    """Header of the rows."""

    def find(self, run: str | None) -> Sequence[Left]:
        """Return the leftovers of a run, or of all runs, in an order in which they can be removed."""

    def remove(self, chosen: Sequence[Left]) -> None:
        """Remove leftovers; those already gone are no error."""

    def summary(self, chosen: Sequence[Left], dry_run: bool) -> str:
        """Return one line about what has been removed, or would be."""


class Backend(Protocol[Work, Outcome]):
    """Runs work of one kind: functions in processes (`calibration.ci.execution.embedded`), or jobs of containers."""

    def run(self, work: Sequence[Work], /, folder: Path, workers: int | None = None) -> Generator[tuple[int, Outcome]]:
        """Run work; yield index and outcome of each item, in the order of completion.

        Invalid work raises an error in this call; nothing is started before the first outcome is requested.
        Closing the iterator, or an exception in its consumer, stops and removes everything.

        Args:
            work: items, started in order.
            folder: each job of containers has a subfolder with its name; results of earlier runs in it are removed.
            workers: maximum number of concurrent items; None for the backend's capacity.

        Raises:
            InputError: a job is invalid, or an image is missing.
            InfrastructureError: the backend cannot be reached, a process died, or a file cannot be written.
        """
        ...


JobBackend = Backend[Job, JobOutcome]


@dataclass(frozen=True)
class BackendKind:
    """Registration of a backend for jobs; its modules are imported when it is opened."""

    target: str
    """``module:callable``, which creates the backend, a context manager, for a `ExecutionTarget`."""
    leftovers: str
    """``module:callable``, which creates its `Leftovers`."""
    settings: Any = None
    """Record of its section of calibration.yml, named as the backend; None if it has none."""
    resumes: bool = False
    """Whether results outlive the command, so that a run of the same name reuses them and runs only missing jobs."""


EMBEDDED = "embedded"
"""Functions of this package, in processes of this machine."""
DOCKER, AWS_BATCH = "docker", "aws-batch"
KINDS: Mapping[str, BackendKind] = {
    DOCKER: BackendKind(
        "calibration.ci.execution.docker.backend:open_docker",
        "calibration.ci.execution.docker.leftovers:EngineLeftovers",
    ),
    AWS_BATCH: BackendKind(
        "calibration.addons.aws_batch.backend:open_batch",
        "calibration.addons.aws_batch.leftovers:open_leftovers",
        settings=BatchSettings,
        resumes=True,
    ),
}
"""Backends for jobs of containers by name; register further ones here."""
CONTAINERS = tuple(KINDS)
BACKENDS = (EMBEDDED, *CONTAINERS)
ContainerBackend = Literal["docker", "aws-batch"]
BackendName = Literal["embedded", ContainerBackend]


@record
class Sections:
    """Settings of backends, each in the section of calibration.yml that is named as the backend."""

    aws_batch: BatchSettings | None = field("Settings of AWS Batch, for containers that run there.", default=None)

    def of(self, backend: str) -> Any:
        """Return the settings of a backend; None if the file has no section for it."""
        return getattr(self, backend.replace("-", "_"), None)


def check_backend(name: str, known: tuple[str, ...] = BACKENDS) -> None:
    """Refuse an unknown backend.

    Raises:
        InputError: the message lists the known ones.
    """
    if name not in known:
        expected = f"{', '.join(known[:-1])} or {known[-1]}"
        raise InputError(f"backend: found '{name}', expected {expected}{did_you_mean(name, known)}")


@dataclass(frozen=True)
class ExecutionTarget:
    """Backend, settings and run to execute jobs of containers."""

    backend: str = DOCKER
    """Name of the backend, a key of `KINDS`."""
    sections: Sections = dataclass_field(default_factory=Sections)
    """Sections of calibration.yml, including that of the backend."""
    run: str | None = None
    """Name of the run; None for a new one."""
    resume: bool = False
    """Whether results of an earlier run of this name are reused, and only missing jobs run."""
    show: LogDisplay | None = None
    """Display for the logs of the containers; None to show none."""

    @property
    def settings(self) -> Any:
        """Settings of the backend; None if it has none."""
        return self.sections.of(self.backend)

    def open(self) -> AbstractContextManager[JobBackend]:
        """Create the backend, which connects when it is entered.

        Raises:
            InputError: its section is missing, or the name of the run is invalid.
        """
        kind = KINDS[self.backend]
        if kind.settings and self.settings is None:
            raise InputError(
                f"backend: found {self.backend}, but its settings are missing: expected a section {self.backend} in "
                "calibration.yml, or a file with one"
            )
        backend: AbstractContextManager[JobBackend] = imported(kind.target)(self)
        return backend


def read_sections(backend: str, path: Path) -> Sections:
    """Read the section of a backend from a file; ``${NAME}`` is replaced by environment variables.

    Raises:
        InputError: the file or the section is missing or wrong; the message names file and key.
    """
    kind = KINDS[backend].settings
    document = read_yaml(path, f"a file with a section {backend}")
    if not isinstance(document, dict) or backend not in document:
        required = ", ".join(key for key, each in flat_fields(kind).items() if each.required)
        raise InputError(f"{path}: missing {backend}: {required}")
    where = f"{path}: {backend}"
    return Sections(**{backend.replace("-", "_"): read(kind, with_variables(document[backend], where), where)})


def imported(target: str) -> Any:
    """Import ``module:attribute``."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)
