"""Execution targets with a backend of the test."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from calibration.ci.execution.backends import ExecutionTarget, JobBackend


@dataclass(frozen=True)
class _At(ExecutionTarget):
    there: JobBackend | None = None

    def open(self) -> AbstractContextManager[JobBackend]:
        assert self.there is not None
        return nullcontext(self.there)


def at(backend: JobBackend) -> ExecutionTarget:
    """Return an execution target with this backend."""
    return _At(there=backend)
