"""Places whose backend is a test's."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from calibration.execution.backends import JobBackend, Place


@dataclass(frozen=True)
class _At(Place):
    there: JobBackend | None = None

    def open(self) -> AbstractContextManager[JobBackend]:
        assert self.there is not None
        return nullcontext(self.there)


def at(backend: JobBackend) -> Place:
    """The place whose jobs this backend runs."""
    return _At(there=backend)
