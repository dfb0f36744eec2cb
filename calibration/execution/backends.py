"""Where work runs, by name."""

from typing import TYPE_CHECKING

from calibration.errors import InputError
from calibration.workflow.text import did_you_mean

if TYPE_CHECKING:
    from calibration.execution.docker.backend import DockerBackend
    from calibration.workflow.streams import LogDisplay

EMBEDDED = "embedded"
"""In processes of this machine, by `calibration.execution.parallel.in_parallel`."""
DOCKER = "docker"
"""In containers, by `calibration.execution.docker.backend.DockerBackend`."""
BACKENDS = (EMBEDDED, DOCKER)


def check_backend(name: str) -> None:
    """Refuse a backend that there is not.

    Raises:
        InputError: naming those that there are.
    """
    if name not in BACKENDS:
        raise InputError(f"backend: found '{name}', expected {' or '.join(BACKENDS)}{did_you_mean(name, BACKENDS)}")


def docker_backend(show: "LogDisplay | None" = None, run: str | None = None) -> "DockerBackend":
    """Make the backend that runs jobs in containers: a context manager, which finds the engine when it is entered.

    Args:
        show: where the logs of the containers are shown.
        run: the name of the run; a new one unless given.
    """
    from calibration.execution.docker.backend import DockerBackend  # brings the SDK

    return DockerBackend(run, show)
