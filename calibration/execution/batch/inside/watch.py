"""The job of a task watched to its end: containers started in their order, stopped, judged, and brought out."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.errors import CalibrationError, ExitCode
from calibration.execution.batch.documents.outcome_document import TaskOutcome
from calibration.execution.batch.inside.local_archive import opener_of
from calibration.execution.batch.inside.script import GRACE
from calibration.execution.batch.inside.signs import Signs
from calibration.execution.batch.inside.watched import SILENCE, WatchedContainer
from calibration.execution.batch.wire import ARRIVAL_SECONDS
from calibration.execution.bringing_out import BringingOut, complete_or_not_at_all
from calibration.execution.extraction import Budget
from calibration.execution.job import Job
from calibration.execution.job_check import start_order
from calibration.execution.judging import Judge, is_running
from calibration.execution.outcome import BroughtOut
from calibration.workflow.text import one_line

_LOOKING = 0.2
"""Seconds between two looks at the containers."""
_ASKING = 5.0
"""Seconds between two questions after containers that do not come."""
_SETTLING = GRACE + 15
"""Seconds in which a container that was told to end does."""


@dataclass(frozen=True)
class Patience:
    """How long is waited for what containers do by themselves."""

    arrival: float = ARRIVAL_SECONDS
    silence: float = SILENCE
    settling: float = _SETTLING


class Watch:
    """A job whose containers wait for being started."""

    def __init__(
        self,
        job: Job,
        signs: Signs,
        output: Path,
        patience: Patience = Patience(),
        neighbours: Callable[[], Mapping[str, int | None]] = dict,
    ) -> None:
        """Begin.

        Args:
            job: the job.
            signs: that its containers give.
            output: the job's volume, as it is mounted here.
            patience: for how long.
            neighbours: which containers have ended, as far as that can be asked, and their exit codes.
        """
        self._job = job
        self._signs = signs
        self._output = output
        self._patience = patience
        self._neighbours = neighbours
        self._judge = Judge(job, one_line)
        self._containers = [WatchedContainer(each, signs, patience.silence) for each in start_order(job)]
        self._artifacts: list[BroughtOut] = []
        self._left_out: list[str] = []

    def run(self, folder: Path) -> None:
        """Watch the job until it has ended; what it leaves is in ``folder`` then, which is not there before.

        Raises:
            WorldError: a sign cannot be given.
        """
        try:
            if self._all_arrive():
                self._judge.began = time.monotonic()
                self._watch()
        finally:
            self._signs.stop()
        self._wait_for_ends()
        if any(c.started is not None for c in self._containers):
            self._judge.judge(self._containers)
            self._bring_out(folder)

    def fail(self, error: CalibrationError) -> None:
        """Take a reason why nothing can be brought out."""
        self._judge.fail(str(error), error.exit_code)
        self._artifacts, self._left_out = [], []

    def outcome(self, attempt: int) -> TaskOutcome:
        """What came of it."""
        return TaskOutcome(
            job=self._job.name,
            attempt=attempt,
            exit_code=self._judge.exit_code,
            reasons=tuple(self._judge.reasons),
            seconds=time.monotonic() - self._judge.began,
            containers=tuple(container.outcome() for container in self._containers),
            artifacts=tuple(self._artifacts),
            left_out=tuple(self._left_out),
        )

    def _all_arrive(self) -> bool:
        """Wait until all containers are there, so that none waits for an image while its job's time runs."""
        deadline = time.monotonic() + self._patience.arrival
        next_question = time.monotonic() + _ASKING
        while missing := [c.container.name for c in self._containers if not c.has_arrived]:
            now = time.monotonic()
            if now >= deadline:
                self._never_came(
                    f"within {self._patience.arrival:g} s nothing was heard of {_named(missing)}: its image"
                )
                return False
            if now >= next_question:
                next_question = now + _ASKING
                ended = self._neighbours()
                if gone := [name for name in missing if name in ended]:
                    code = "" if ended[gone[0]] is None else f" with exit code {ended[gone[0]]}"
                    self._never_came(f"container '{gone[0]}' ended at once{code}: its image")
                    return False
            time.sleep(_LOOKING)
        return True

    def _never_came(self, what: str) -> None:
        why = "cannot be pulled or has no /bin/sh, or its entrypoint does not run what it is given"
        self._judge.fail(f"{what} {why}", ExitCode.BAD_INPUT)

    def _watch(self) -> None:
        """Start the containers, and wait until one ends the job, or its time has run out."""
        waiting = list(self._containers)
        while True:
            self._start_those_that_may(waiting)
            unready = [c for c in self._containers if not c.ready]
            for container in self._containers:
                container.look()
            if self._judge.is_over(self._containers, waiting):
                return
            if not any(c.ready for c in unready):  # else whoever waits for it starts at once
                left = [max(0.0, seconds) for seconds in self._judge.seconds_left(self._containers)]
                time.sleep(min([*left, _LOOKING]))

    def _start_those_that_may(self, waiting: list[WatchedContainer]) -> None:
        by_name = {c.container.name: c for c in self._containers}
        for container in list(waiting):
            if all(by_name[name].ready for name in container.container.after):
                container.start()
                waiting.remove(container)

    def _wait_for_ends(self) -> None:
        """Wait until all that run have ended; one that does not is killed with the task."""
        self._judge.stop(self._containers)
        deadline = time.monotonic() + self._patience.settling
        while (running := _running(self._containers)) and time.monotonic() < deadline:
            for container in running:
                container.look()
            time.sleep(_LOOKING / 4)
        for container in self._containers:
            container.read_end(self._judge.stopped_for.get(container.container.name))

    def _bring_out(self, folder: Path) -> None:
        budget = Budget(self._job.artifact_bytes, self._job.artifact_files)
        opener = opener_of(self._output)
        try:
            with complete_or_not_at_all(folder) as place:
                found = BringingOut(place, budget, lambda: None)
                for container in self._containers:
                    if container.started is not None:
                        found.bring_out(container.container, opener)
        except CalibrationError as error:
            self.fail(error)
            return
        self._artifacts, self._left_out = found.files, found.left_out
        if not self._judge.reasons:  # else that is why
            for line in found.missing:
                self._judge.fail(line, ExitCode.FAIL)


def _running(containers: Sequence[WatchedContainer]) -> list[WatchedContainer]:
    return [container for container in containers if is_running(container)]


def _named(names: Sequence[str]) -> str:
    return ("container " if len(names) == 1 else "containers ") + ", ".join(f"'{name}'" for name in names)
