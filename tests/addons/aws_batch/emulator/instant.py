"""Jobs that are a function of the test: nothing runs, so ten thousand of them are done in seconds."""

from collections.abc import Callable, Mapping

from .attempt import Attempt, ContainerEnd, Ended

Function = Callable[[Attempt], Ended | None]
"""What becomes of an attempt; None for containers that all end with 0. It may wait for ``attempt.stop``, which is set
when the job is terminated, has run too long or lost its host: what it returns then counts for the containers only."""


class Instant:
    """Runs attempts by calling a function."""

    def __init__(self, function: Function | None = None) -> None:
        self.function = function or (lambda _: None)

    def run(self, attempt: Attempt) -> Ended:
        """Call the function, unless the host is lost at once."""
        for container in attempt.containers:
            attempt.starts(container["name"])
        attempt.runs()
        if attempt.lost_after == 0:
            return host_lost()
        return self.function(attempt) or ended(attempt)

    def close(self) -> None:
        """Nothing is left."""


def ended(
    attempt: Attempt,
    codes: Mapping[str, int] | None = None,
    reasons: Mapping[str, str] | None = None,
    seconds: float | None = None,
) -> Ended:
    """All containers have ended, with 0 unless told otherwise.

    Args:
        attempt: that ended.
        codes: exit codes, by containers' names.
        reasons: what Batch says of containers: ``OutOfMemoryError: Container killed due to memory usage``.
        seconds: how long it claims to have run.
    """
    names = [container["name"] for container in attempt.containers]
    codes, reasons = codes or {}, reasons or {}
    return Ended({name: ContainerEnd(codes.get(name, 0), reasons.get(name)) for name in names}, seconds=seconds)


def failed_to_start(reason: str) -> Ended:
    """No container ran: ``CannotPullContainerError: ...``."""
    return Ended({}, started=False, reason=reason)


def host_lost(seconds: float | None = None) -> Ended:
    """The host is gone, whatever the function has done before (uploads, say)."""
    return Ended({}, host_lost=True, seconds=seconds)
