"""Supervision of a job's containers from the first start to the artifacts: one loop for all container backends."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Generic, TypeVar

from calibration.base.errors import ExitCode
from calibration.ci.execution.copying_out import ArtifactCopier, Opener, complete_or_not_at_all
from calibration.ci.execution.extraction import Budget
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.job_verdict import Judge, is_running
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End

_POLL_SECONDS = 0.2
"""Interval of readiness polls, seconds."""


class Supervised(ABC):
    """Container of a job; a :class:`calibration.ci.execution.job_verdict.Watched`."""

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
            if not has_news:
                limits = self.judge.seconds_left(self.containers)
                if any(is_running(c) and not c.ready for c in self.containers):
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
