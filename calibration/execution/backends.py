"""Where the poses of a collection and the worlds of a scenario set are worked on."""

from collections.abc import Callable, Mapping

from calibration.errors import InputError
from calibration.execution.parallel import in_parallel

Backend = Callable[..., object]
"""As `in_parallel`: does the same work on many items."""
BACKENDS: Mapping[str, Backend] = {"embedded": in_parallel}
"""By name. Embedded: in processes on this machine."""


def check_backend(name: str) -> None:
    """Refuse a backend that there is not.

    Raises:
        InputError: naming those that there are.
    """
    if name not in BACKENDS:
        raise InputError(f"backend: found '{name}', expected {' or '.join(BACKENDS)}")
