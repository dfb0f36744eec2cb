"""Registry of backends, and their interface for the rest of the package.

A backend for jobs is an entry of `BACKEND_KINDS`: its factory, and the removal of leftovers of killed runs. Its
settings are the section of calibration.yml that is named as it.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, TypeVar

from calibration.base import InputError, did_you_mean, read_yaml, with_variables
from calibration.base.addons import BackendKind, import_attribute, of_addons
from calibration.base.records import field, flat_fields, read, record, with_fields
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.execution.supervision import BeginWatch
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
    """Runs work of one kind: functions in processes (`calibration.ci.execution.tasks`), or jobs of containers."""

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


EMBEDDED = "embedded"
"""Functions of this package, in processes of this machine."""
DOCKER = "docker"
BACKEND_KINDS: Mapping[str, BackendKind] = {
    DOCKER: BackendKind(
        "calibration.ci.execution.docker.backend:open_docker",
        "calibration.ci.execution.docker.run_objects:EngineLeftovers",
    ),
    **of_addons(lambda addon: addon.backends),
}
"""Backends for jobs of containers by name."""
CONTAINER_BACKENDS = tuple(BACKEND_KINDS)
CLOUDS = tuple(name for name, kind in BACKEND_KINDS.items() if kind.resumes)
CLOUDS_TEXT = " or ".join(CLOUDS) or "of a cloud, and none is installed"
BACKEND_NAMES = (EMBEDDED, *CONTAINER_BACKENDS)
if TYPE_CHECKING:
    ContainerBackend: TypeAlias = str
    BackendName: TypeAlias = str
else:
    ContainerBackend = Literal[CONTAINER_BACKENDS]
    BackendName = Literal[BACKEND_NAMES]
SECTIONS = {
    name: (import_attribute(section.record), section.help)
    for name, section in of_addons(lambda addon: addon.sections).items()
}
"""Record and description of each section that an add-on has in calibration.yml."""


@record
@with_fields(
    {
        name.replace("-", "_"): (kind | None, field(description, default=None))
        for name, (kind, description) in SECTIONS.items()
    }
)
class Sections:
    """Sections of calibration.yml that add-ons bring; that of a backend has its name."""

    def of(self, name: str) -> Any:
        """Return the record of a section; None if the file has none of this name."""
        return getattr(self, name.replace("-", "_"), None)


def check_backend(name: str, known: tuple[str, ...] = BACKEND_NAMES) -> None:
    """Refuse an unknown backend.

    Raises:
        InputError: the message lists the known ones.
    """
    if name not in known:
        expected = " or ".join(filter(None, (", ".join(known[:-1]), known[-1])))
        raise InputError(f"backend: found '{name}', expected {expected}{did_you_mean(name, known)}")


@dataclass(frozen=True)
class ExecutionTarget:
    """Backend, settings and run to execute jobs of containers."""

    backend: str = DOCKER
    """Name of the backend, a key of `BACKEND_KINDS`."""
    sections: Sections = dataclass_field(default_factory=Sections)
    """Sections of calibration.yml, including that of the backend."""
    run: str | None = None
    """Name of the run; None for a new one."""
    resume: bool = False
    """Whether results of an earlier run of this name are reused, and only missing jobs run."""
    show: LogDisplay | None = None
    """Display for the logs of the containers; None to show none."""
    watch: BeginWatch | None = None
    """Watch of each job, by backends that reach the containers; None for none."""

    @property
    def settings(self) -> Any:
        """Settings of the backend; None if it has none."""
        return self.sections.of(self.backend)

    def open(self) -> AbstractContextManager[JobBackend]:
        """Create the backend, which connects when it is entered.

        Raises:
            InputError: its section is missing, or the name of the run is invalid.
        """
        if self.backend in SECTIONS and self.settings is None:
            raise InputError(
                f"backend: found {self.backend}, but its settings are missing: expected a section {self.backend} in "
                "calibration.yml, or a file with one"
            )
        backend: AbstractContextManager[JobBackend] = import_attribute(BACKEND_KINDS[self.backend].target)(self)
        return backend


def read_sections(backend: str, path: Path) -> Sections:
    """Read the section of a backend from a file; ``${NAME}`` is replaced by environment variables.

    Raises:
        InputError: the file or the section is missing or wrong; the message names file and key.
    """
    kind, _ = SECTIONS[backend]
    document = read_yaml(path, f"a file with a section {backend}")
    if not isinstance(document, dict) or backend not in document:
        required = ", ".join(key for key, each in flat_fields(kind).items() if each.required)
        raise InputError(f"{path}: missing {backend}: {required}")
    section = with_variables(document[backend], f"{path}: {backend}")
    return read(Sections, {backend: section}, str(path))
