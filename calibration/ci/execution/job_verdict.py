"""Verdict of a job from the ends of its containers, with the same messages for all backends."""

import signal
import time
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from calibration.base.errors import ExitCode
from calibration.ci.execution.job import Container, Job, Readiness
from calibration.ci.execution.outcome import End
from calibration.ci.execution.sizes import describe_bytes

_SIGNAL_EXIT_CODES = 128  # a shell reports the end by signal N as 128 + N
_HINT_OF_EXIT_CODE = {126: "its command is not executable", 127: "its command was not found"}


class Watched(Protocol):
    """A container before, during or after its run, as the verdict sees it."""

    @property
    def container(self) -> Container:
        """Definition of the container."""

    @property
    def started(self) -> float | None:
        """Start time of the monotonic clock."""

    @property
    def ended(self) -> float | None:
        """End time of the monotonic clock."""

    @property
    def ready(self) -> bool:
        """Whether it has been ready."""

    @property
    def end(self) -> End:
        """Way in which it ended, once known."""

    @property
    def exit_code(self) -> int | None:
        """Exit code, once known."""

    @property
    def signal(self) -> str | None:
        """Signal that killed it, once known."""

    @property
    def last_line(self) -> str:
        """Last line of its log, safe for a message; empty if unknown."""

    def not_ready_for(self) -> str:
        """Return the unmet conditions of its readiness, for a message."""


class Judge:
    """Determines when a job is over, which containers are stopped, and whether and why it has failed."""

    def __init__(self, job: Job, clean: Callable[[str], str]) -> None:
        """Start the time of the job.

        Args:
            job: supervised job.
            clean: makes a reason safe to show.
        """
        self.reasons: list[str] = []
        """Reasons of the failure, the cause first."""
        self.exit_code = ExitCode.PASS
        self.stopped_for: dict[str, End] = {}
        """Reasons why containers were stopped, by name."""
        self.began = time.monotonic()
        self._job = job
        self._clean = clean
        self._too_early: str | None = None
        """Container that ended before it was ready, while others waited for it."""

    def fail(self, reason: str, code: ExitCode) -> None:
        """Add a reason of the failure; the first one is its cause."""
        if not self.reasons:
            self.exit_code = code
        self.reasons.append(self._clean(reason))

    def is_over(self, containers: Sequence[Watched], waiting: Sequence[Watched]) -> bool:
        """Return whether the job is over: by the end of a container, or by a time limit of the job or a container.

        Args:
            containers: all containers of the job.
            waiting: containers that have not been started.
        """
        ended = [c for c in containers if c.ended is not None]
        if any(c.container.essential for c in ended):
            return True
        needed = {name for c in waiting for name in c.container.after}
        for container in ended:
            if not container.ready and container.container.name in needed:
                self._too_early = container.container.name
                return True
        return self._is_too_late(containers, waiting)

    def seconds_left(self, containers: Sequence[Watched]) -> list[float]:
        """Return the seconds until each time limit."""
        now = time.monotonic()
        left = [] if self._job.seconds is None else [self.began + self._job.seconds - now]
        for container in containers:
            if is_running(container) and container.started is not None:
                limits = [container.container.limits.seconds]
                if container.container.readiness is not None and not container.ready:
                    limits.append(container.container.readiness.seconds)
                left += [container.started + limit - now for limit in limits if limit is not None]
        return left

    def stop(self, containers: Sequence[Watched]) -> None:
        """Record that the remaining containers are stopped because the job is over."""
        for container in containers:
            if is_running(container):
                self.stopped_for.setdefault(container.container.name, End.STOPPED)

    def judge(self, containers: Sequence[Watched]) -> None:
        """Determine whether and why the job has failed, after the ends of all containers are known."""
        essential = [c for c in containers if c.container.essential]
        for container in essential:
            if (failure := failure_of(container)) is not None:
                self.fail(failure, ExitCode.FAIL)
        early = next((c for c in containers if c.container.name == self._too_early), None)
        if early is not None and not self.reasons:
            how = failure_of(early) or f"container '{self._too_early}' ended with exit code {early.exit_code}"
            self.fail(f"{how}; it was not ready yet ({early.not_ready_for()})", ExitCode.FAIL)
        for container in essential:
            if container.end == End.NOT_STARTED and not self.reasons:
                name = container.container.name
                self.fail(f"container '{name}' was not started: another container ended the job", ExitCode.FAIL)
        if not self.reasons and not any(c.end == End.EXITED for c in essential):
            self.fail("the end of the job is unknown", ExitCode.INFRASTRUCTURE)
        if self.reasons:  # further failures may explain the first
            others = [c for c in containers if not c.container.essential and c is not early]
            self.reasons += [self._clean(failure) for c in others if (failure := failure_of(c)) is not None]

    def _is_too_late(self, containers: Sequence[Watched], waiting: Sequence[Watched]) -> bool:
        now = time.monotonic()
        if self._job.seconds is not None and now - self.began >= self._job.seconds:
            running = [c.container.name for c in containers if is_running(c)]
            self.stopped_for |= dict.fromkeys(running, End.TIMED_OUT)
            still = f": still running were {', '.join(running)}" if running else ""
            never = f"; not started were {', '.join(c.container.name for c in waiting)}" if waiting else ""
            self.fail(f"the job ran longer than its {self._job.seconds:g} s{still}{never}", ExitCode.INFRASTRUCTURE)
            return True
        for container in containers:
            if not is_running(container) or container.started is None:
                continue
            name, seconds = container.container.name, now - container.started
            limit, readiness = container.container.limits.seconds, container.container.readiness
            if limit is not None and seconds >= limit:
                self.stopped_for[name] = End.TIMED_OUT
                self.fail(
                    f"container '{name}' ran longer than its {limit:g} s{_quote_last_line(container)}",
                    ExitCode.INFRASTRUCTURE,
                )
                return True
            if readiness is not None and not container.ready and seconds >= readiness.seconds:
                self.stopped_for[name] = End.NOT_READY
                missing = f"within {readiness.seconds:g} s ({container.not_ready_for()})"
                self.fail(f"container '{name}' was not ready {missing}{_quote_last_line(container)}", ExitCode.FAIL)
                return True
        return False


def is_running(container: Watched) -> bool:
    """Return whether a container was started, and has not ended."""
    return container.started is not None and container.ended is None


def how_it_ended(container: Container, exit_code: int, out_of_memory: bool, ours: End | None) -> tuple[End, str | None]:
    """Return how a container ended, and the signal that killed it.

    Args:
        container: its definition.
        exit_code: its exit code.
        out_of_memory: whether the kernel killed a process for lack of memory.
        ours: reason why it was stopped; None if it ended by itself.
    """
    killed_by = None if exit_code in container.success else signal_of(exit_code)
    if out_of_memory:
        return End.OUT_OF_MEMORY, killed_by
    if ours is not None:
        return ours, killed_by
    if killed_by == "SIGKILL" and container.limits.memory is not None:
        return End.OUT_OF_MEMORY, killed_by  # the event may be lost; nothing else sends SIGKILL
    return (End.SIGNALLED if killed_by else End.EXITED), killed_by


def failure_of(watched: Watched) -> str | None:
    """Failure message of a container, or None if it succeeded."""
    container = f"container '{watched.container.name}'"
    if watched.end == End.OUT_OF_MEMORY:
        limit = watched.container.limits.memory
        known = "the machine had no free memory" if limit is None else f"its limit is {describe_bytes(limit)} (memory)"
        return f"{container} ran out of memory: {known}{_quote_last_line(watched)}"
    if watched.end == End.SIGNALLED:
        return f"{container} was killed by {watched.signal}{_quote_last_line(watched)}"
    if watched.end == End.LOST:
        return f"{container} ended without an exit code: it was killed{_quote_last_line(watched)}"
    if watched.end == End.EXITED and watched.exit_code not in watched.container.success:
        hint = f" ({_HINT_OF_EXIT_CODE[watched.exit_code]})" if watched.exit_code in _HINT_OF_EXIT_CODE else ""
        if not watched.container.success:
            hint += ", before the job was done"
        return f"{container} ended with exit code {watched.exit_code}{hint}{_quote_last_line(watched)}"
    return None


def unmet(readiness: Readiness, names: Collection[str], log_has_line: bool) -> str:
    """Return the unmet conditions of a readiness check, for a message.

    Args:
        readiness: the check.
        names: unmet conditions among ``port``, ``file`` and ``command``.
        log_has_line: whether the log contains the requested line.
    """
    asked = {"port": readiness.port, "file": readiness.file, "command": " ".join(readiness.command)}
    found = [f"{name} {asked[name]}" for name in sorted(names)]
    if readiness.log and not log_has_line:
        found.append(f"a line of its log with '{readiness.log}'")
    return ", ".join(found)


def signal_of(exit_code: int) -> str | None:
    """Return the signal encoded in an exit code, by the shell's convention; None if there is none."""
    try:
        return signal.Signals(exit_code - _SIGNAL_EXIT_CODES).name if exit_code > _SIGNAL_EXIT_CODES else None
    except ValueError:
        return None


def _quote_last_line(watched: Watched) -> str:
    return f": {watched.last_line}" if watched.last_line else ""
