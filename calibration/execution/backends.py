"""Where work runs, by name."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from calibration.errors import InputError
from calibration.execution.backend import Backend
from calibration.execution.batch.settings import SECTION, BatchSettings
from calibration.workflow.text import did_you_mean

if TYPE_CHECKING:
    from calibration.workflow.streams import LogDisplay

EMBEDDED = "embedded"
"""In processes of this machine, by `calibration.execution.parallel.in_parallel`."""
DOCKER = "docker"
"""In containers of this machine's engine, by `calibration.execution.docker.backend.DockerBackend`."""
AWS_BATCH = "aws-batch"
"""In containers in the cloud, by `calibration.execution.batch.backend.BatchBackend`."""
CONTAINERS = (DOCKER, AWS_BATCH)
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
    """Where containers run."""

    backend: str = DOCKER
    """One of `CONTAINERS`."""
    batch: BatchSettings | None = None
    """What AWS Batch has to know."""
    run: str | None = None
    """The name of the run; a new one unless given."""
    resume: bool = False
    """Whether what is left in the cloud of a run of this name is taken, and only what is missing is run."""

    def open(self, show: "LogDisplay | None" = None) -> AbstractContextManager[Backend]:
        """Make the backend, which is looked for when it is entered.

        Args:
            show: where the logs of the containers are shown.

        Raises:
            InputError: nothing says where in the cloud.
        """
        if self.backend == DOCKER:
            from calibration.execution.docker.backend import DockerBackend  # brings the SDK

            return DockerBackend(self.run, show)
        if self.batch is None:
            raise InputError(
                f"backend: found {AWS_BATCH}, but nothing says where in AWS: expected a section {SECTION} in "
                "calibration.yml, or a file with one"
            )
        from calibration.execution.batch.backend import BatchBackend  # brings the SDK

        return BatchBackend(self.batch, self.run, show, self.resume)
