"""Supervision of a job's containers from the first start to the artifacts, and the verdict, for all backends."""

import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Generic, Protocol, TypeAlias, TypeVar

from calibration.base import ExitCode
from calibration.ci.execution.extraction import Budget
from calibration.ci.execution.job import Container, Job, Readiness, describe_bytes
from calibration.ci.execution.outcome import (
    ArtifactCopier,
    ArtifactFile,
    ContainerOutcome,
    End,
    Opener,
    complete_or_not_at_all,
)

_SIGNAL_EXIT_CODES = 128  # a shell reports the end by signal N as 128 + N
_HINT_OF_EXIT_CODE = {126: "its command is not executable", 127: "its command was not found"}


class Supervised(ABC):
    """Container of a job before, during or after its run."""

    image = ""
    log: Path | None = None

    def __init__(self, container: Container) -> None:
        self.container = container
        self.name = container.name
        self.started: float | None = None
        self.ended: float | None = None
        self.ready = False
        self.end: End = End.NOT_STARTED
        self.exit_code: int | None = None
        self.signal: str | None = None

    @abstractmethod
    def poll(self) -> None:
        """Update ``ready``, and ``ended`` unless it is updated elsewhere.

        Raises:
            InfrastructureError: the container cannot be polled.
        """

    @abstractmethod
    def not_ready_for(self) -> str:
        """Return the unmet conditions of its readiness, for a message."""

    @property
    def last_line(self) -> str:
        """Last line of its output, safe for a message; empty if unknown."""
        return ""

    def outcome(self) -> ContainerOutcome:
        """Outcome of the container; its end is lost if it was started and its end is unknown."""
        began = self.started is not None
        seconds = 0.0 if self.started is None else (self.ended or time.monotonic()) - self.started
        end = End.LOST if began and self.end == End.NOT_STARTED else self.end
        log = self.log if began else None
        return ContainerOutcome(self.name, end, self.exit_code, self.signal, seconds, log, self.image)


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

    def is_over(self, containers: Sequence[Supervised], waiting: Sequence[Supervised]) -> bool:
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

    def seconds_left(self, containers: Sequence[Supervised]) -> list[float]:
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

    def stop(self, containers: Sequence[Supervised]) -> None:
        """Record that the remaining containers are stopped because the job is over."""
        for container in containers:
            if is_running(container):
                self.stopped_for.setdefault(container.container.name, End.STOPPED)

    def judge(self, containers: Sequence[Supervised]) -> None:
        """Determine whether and why the job has failed, after the ends of all containers are known."""
        essential = [c for c in containers if c.container.essential]
        for container in essential:
            if (failure := _failure_of(container)) is not None:
                self.fail(failure, ExitCode.FAIL)
        early = next((c for c in containers if c.container.name == self._too_early), None)
        if early is not None and not self.reasons:
            how = _failure_of(early) or f"container '{self._too_early}' ended with exit code {early.exit_code}"
            self.fail(f"{how}; it was not ready yet ({early.not_ready_for()})", ExitCode.FAIL)
        for container in essential:
            if container.end == End.NOT_STARTED and not self.reasons:
                name = container.container.name
                self.fail(f"container '{name}' was not started: another container ended the job", ExitCode.FAIL)
        if not self.reasons and not any(c.end == End.EXITED for c in essential):
            self.fail("the end of the job is unknown", ExitCode.INFRASTRUCTURE)
        if self.reasons:  # further failures may explain the first
            others = [c for c in containers if not c.container.essential and c is not early]
            self.reasons += [self._clean(failure) for c in others if (failure := _failure_of(c)) is not None]

    def _is_too_late(self, containers: Sequence[Supervised], waiting: Sequence[Supervised]) -> bool:
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


def is_running(container: Supervised) -> bool:
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


def failure_of(container: Container, ended: ContainerOutcome | Supervised, last_line: str) -> str | None:
    """Return the failure message of a container that has ended, or None if it succeeded.

    Args:
        container: its definition.
        ended: how it ended.
        last_line: last line of its log, safe for a message; empty if unknown.
    """
    name, last = f"container '{container.name}'", f": {last_line}" if last_line else ""
    if ended.end == End.OUT_OF_MEMORY:
        limit = container.limits.memory
        known = "the machine had no free memory" if limit is None else f"its limit is {describe_bytes(limit)} (memory)"
        return f"{name} ran out of memory: {known}{last}"
    if ended.end == End.SIGNALLED:
        return f"{name} was killed by {ended.signal}{last}"
    if ended.end == End.LOST:
        return f"{name} ended without an exit code: it was killed{last}"
    if ended.end == End.EXITED and ended.exit_code not in container.success:
        hint = f" ({_HINT_OF_EXIT_CODE[ended.exit_code]})" if ended.exit_code in _HINT_OF_EXIT_CODE else ""
        if not container.success:
            hint += ", before the job was done"
        return f"{name} ended with exit code {ended.exit_code}{hint}{last}"
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


def _failure_of(supervised: Supervised) -> str | None:
    return failure_of(supervised.container, supervised, supervised.last_line)


def _quote_last_line(supervised: Supervised) -> str:
    return f": {supervised.last_line}" if supervised.last_line else ""


class JobWatch(Protocol):
    """Follows what the containers of a job say while they run, in a thread of its own."""

    @property
    def reason(self) -> str:
        """Why the job has failed, and is to be ended; empty as long as nothing is known."""

    def close(self) -> None:
        """End the watch: the containers are about to be stopped."""


BeginWatch: TypeAlias = Callable[[Callable[[], Sequence[str]], Callable[[str], None]], JobWatch]
"""Begins the watch of a job. Its arguments return the addresses of the running containers, and write a line to the
watch's log."""
_POLL_SECONDS = 0.2
"""Interval of polls of the readiness and the watch, seconds."""


C = TypeVar("C", bound=Supervised)


class Supervisor(ABC, Generic[C]):
    """Starts the containers of a job in order, stops them when it is over, judges it and copies its artifacts out."""

    def __init__(self, job: Job, clean: Callable[[str], str]) -> None:
        """Create the supervisor, and start the time of the job.

        Args:
            job: job to supervise.
            clean: makes a reason safe to show.
        """
        self.job = job
        self.containers: list[C] = []
        """Containers of the job, in the order of their start."""
        self.judge = Judge(job, clean)
        self.watch: JobWatch | None = None
        self.artifacts: list[ArtifactFile] = []
        self.left_out: list[str] = []

    def supervise(self, folder: Path) -> None:
        """Run the containers until the job is over, judge it, and copy its artifacts.

        Args:
            folder: target of the artifacts, which must not exist.

        Raises:
            CalibrationError: a container cannot be started or polled, or an artifact cannot be copied.
        """
        try:
            self._until_over()
        finally:
            if self.watch is not None:
                self.watch.close()
            running = [c for c in self.containers if is_running(c)]
            self.judge.stop(running)
            self._stop(running)
            self._go_on()
        for container in self.containers:
            if container.started is not None:
                self._read_end(container, self.judge.stopped_for.get(container.name))
        self.judge.judge(self.containers)
        self._copy_out(folder)

    @abstractmethod
    def _start(self, container: C) -> None:
        """Start a container."""

    @abstractmethod
    def _wait(self, seconds: float | None) -> None:
        """Wait for the end of a container, for at most this many seconds."""

    @abstractmethod
    def _stop(self, running: Sequence[C]) -> None:
        """Ask containers to end."""

    @abstractmethod
    def _read_end(self, container: C, ours: End | None) -> None:
        """Wait for the end of a started container, and determine how it ended; ``ours`` is why it was stopped."""

    @abstractmethod
    def _opener(self, container: C) -> Opener:
        """Return an opener for the files of a container."""

    def _go_on(self) -> None:
        """Raise if the whole run is being stopped."""

    def _until_over(self) -> None:
        waiting = list(self.containers)
        while True:
            self._go_on()
            self._start_those_that_may(waiting)
            has_news = self._poll()
            if self.judge.is_over(self.containers, waiting):
                return
            if self.watch is not None and self.watch.reason:
                self.judge.fail(self.watch.reason, ExitCode.FAIL)
                return
            if not has_news:
                limits = self.judge.seconds_left(self.containers)
                if self.watch is not None or any(is_running(c) and not c.ready for c in self.containers):
                    limits.append(_POLL_SECONDS)
                self._wait(max(0.0, min(limits)) if limits else None)

    def _poll(self) -> bool:
        """Poll running containers; return True at once if one has become ready, to start those that wait for it."""
        for container in self.containers:
            was_ready = container.ready
            if is_running(container):
                container.poll()
            if container.ready and not was_ready:
                return True
        return False

    def _start_those_that_may(self, waiting: list[C]) -> None:
        ready = {c.name for c in self.containers if c.ready}
        for container in list(waiting):
            if ready.issuperset(container.container.after):
                self._go_on()
                self._start(container)
                waiting.remove(container)
                if container.ready:
                    ready.add(container.name)

    def _copy_out(self, folder: Path) -> None:
        with complete_or_not_at_all(folder) as place:
            found = ArtifactCopier(place, Budget(self.job.artifact_bytes, self.job.artifact_files), self._go_on)
            for container in self.containers:
                if container.started is not None:
                    found.copy(container.container, self._opener(container))
        self.artifacts, self.left_out = found.files, found.left_out
        if not self.judge.reasons:  # otherwise the failure explains missing artifacts
            for line in found.missing:
                self.judge.fail(line, ExitCode.FAIL)
