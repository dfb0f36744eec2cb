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
from calibration.execution.bringing_out import Opener
from calibration.execution.job import Job
from calibration.execution.job_check import start_order
from calibration.execution.judging import is_running
from calibration.execution.outcome import End
from calibration.execution.supervision import Supervisor
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


class Watch(Supervisor[WatchedContainer]):
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
        super().__init__(job, one_line)
        self._signs = signs
        self._output = output
        self._patience = patience
        self._neighbours = neighbours
        self.containers = [WatchedContainer(each, signs, patience.silence) for each in start_order(job)]
        self._settled = 0.0
        """When those that were told to end have had their time for it."""

    def run(self, folder: Path) -> None:
        """Watch the job until it has ended; what it leaves is in ``folder`` then, which is not there before.

        Raises:
            WorldError: a sign cannot be given.
        """
        try:
            if self._all_arrive():
                self.judge.began = time.monotonic()
                self.supervise(folder)
        except CalibrationError as error:
            self.fail(error)
        finally:
            self._signs.stop()

    def fail(self, error: CalibrationError) -> None:
        """Take a reason why nothing can be brought out."""
        self.judge.fail(str(error), error.exit_code)
        self.artifacts, self.left_out = [], []

    def outcome(self, attempt: int) -> TaskOutcome:
        """What came of it."""
        return TaskOutcome(
            job=self.job.name,
            attempt=attempt,
            exit_code=self.judge.exit_code,
            reasons=tuple(self.judge.reasons),
            seconds=time.monotonic() - self.judge.began,
            containers=tuple(container.outcome() for container in self.containers),
            artifacts=tuple(self.artifacts),
            left_out=tuple(self.left_out),
        )

    def _all_arrive(self) -> bool:
        """Wait until all containers are there, so that none waits for an image while its job's time runs."""
        deadline = time.monotonic() + self._patience.arrival
        next_question = time.monotonic() + _ASKING
        while missing := [c.container.name for c in self.containers if not c.has_arrived]:
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
        self.judge.fail(f"{what} {why}", ExitCode.BAD_INPUT)

    def _start(self, container: WatchedContainer) -> None:
        container.start()

    def _wait(self, seconds: float | None) -> None:
        """Wait for the next look: nobody tells of an end."""
        time.sleep(_LOOKING if seconds is None else min(seconds, _LOOKING))

    def _stop(self, running: Sequence[WatchedContainer]) -> None:
        self._signs.stop()
        self._settled = time.monotonic() + self._patience.settling

    def _read_end(self, container: WatchedContainer, ours: End | None) -> None:
        """Wait for its end; a container that does not end is killed with the task."""
        while is_running(container) and time.monotonic() < self._settled:
            container.look()
            time.sleep(_LOOKING / 4)
        container.read_end(ours)

    def _opener(self, container: WatchedContainer) -> Opener:
        return opener_of(self._output)


def _named(names: Sequence[str]) -> str:
    return ("container " if len(names) == 1 else "containers ") + ", ".join(f"'{name}'" for name in names)
