"""Many scenarios in containers: each is a job with an output folder, which is kept once it is complete."""

import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.base.errors import ExitCode, InfrastructureError, InputError
from calibration.base.temporary_folder import temporary_folder
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.job import Job
from calibration.ci.execution.job_folder import LOGS
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.pipeline.collection.scenario_file import read_scenario, write_scenario
from calibration.pipeline.collection.scenario_report import REPORT_FILES
from calibration.robot.simulation.scenarios.scenario import ScenarioResult

SCENARIOS = "scenarios"
"""Folder of the datasets, with a folder for each scenario."""

ScenarioDone = Callable[[int, int, ScenarioResult], None]
"""Callback after each scenario; first for those already finished."""


@dataclass(frozen=True)
class Judged:
    """Result of a scenario, and whether its job could run."""

    result: ScenarioResult
    error: ExitCode | None = None
    """Set if it could not run: a wrong image (2), the engine, the host or the time (3)."""
    complete: bool = True
    """Whether it is final, so that running it again is useless."""


class Scenarios(ABC):
    """Scenarios of a request whose files are read; each can run as a job of containers."""

    system: str
    pending: Sequence[ScenarioResult]
    """Result of each scenario before it has run: id, hash and values."""
    stillness: float | None
    """Limit of a pattern's motion while the sensors measure, m; None for no limit."""

    @abstractmethod
    def write_inputs(self, folder: Path) -> Path | None:
        """Write the input of all jobs into a new folder; None if there is none."""

    @abstractmethod
    def job(self, number: int, inputs: Path | None) -> Job:
        """Return the job of a scenario."""

    @abstractmethod
    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a scenario by its job's output; its dataset is moved to ``new``, which does not exist yet."""


@dataclass(frozen=True)
class ScenarioFolder:
    """Output folder of many scenarios."""

    output: Path
    resume: bool = False
    """Whether results of an earlier run are kept, and only missing ones run."""
    overwrite: bool = False
    """Whether results of an earlier run are removed."""

    def make_room(self) -> None:
        """Prepare the output folder: remove the report of an earlier run, and its scenarios if requested.

        Raises:
            InputError: there are scenarios of an earlier run, and neither `resume` nor `overwrite` is set.
            InfrastructureError: the folder cannot be written.
        """
        place = self.output / SCENARIOS
        if place.exists() and not (self.resume or self.overwrite):
            raise InputError(
                f"{place}: exists already; --overwrite replaces the scenarios, --resume runs what is missing"
            )
        try:
            self.output.mkdir(parents=True, exist_ok=True)
            for name in REPORT_FILES:
                (self.output / name).unlink(missing_ok=True)
            if not self.resume:
                for folder in (place, self.output / LOGS):
                    if folder.exists():
                        shutil.rmtree(folder)
        except OSError as error:
            raise InfrastructureError(f"{self.output}: cannot be written: {error.strerror or error}") from error

    def task(self, scenarios: Scenarios, number: int, inputs: Path | None, work: Path) -> Task[Judged]:
        """Return the task of a scenario.

        Args:
            scenarios: all scenarios.
            number: index of the scenario.
            inputs: the input folder of all jobs.
            work: a folder in the output folder, for incomplete results.
        """

        def judge(outcome: JobOutcome) -> Judged:
            return self._take(scenarios, number, outcome, work / "new")

        return Task.containers(scenarios.pending[number].id, scenarios.job(number, inputs), judge)

    def find(self, pending: ScenarioResult, stillness: float | None) -> Judged | None:
        """Return the result of a scenario in an earlier run; None if it is missing, or of another scenario."""
        if not self.resume:
            return None
        try:
            return Judged(read_scenario(self.output / SCENARIOS / pending.id, pending, stillness))
        except InputError:
            return None

    def _take(self, scenarios: Scenarios, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a scenario, and move its output into place as a whole."""
        name = scenarios.pending[number].id
        try:
            judged = scenarios.judge(number, outcome, new)
            _replace(outcome.folder / LOGS, self.output / LOGS / name)
            if judged.complete:
                write_scenario(judged.result, scenarios.stillness, new)
                _replace(new, self.output / SCENARIOS / name)
            for left in (new, outcome.folder):
                if left.exists():
                    shutil.rmtree(left)
        except OSError as error:
            raise InfrastructureError(f"{self.output}: cannot be written: {error.strerror or error}") from error
        return judged


def run_in_containers(
    scenarios: Scenarios, folder: ScenarioFolder, jobs: int | None, target: ExecutionTarget | None, done: ScenarioDone
) -> list[Judged]:
    """Run scenarios as jobs of containers; their datasets and logs are stored in the folder.

    Raises:
        InputError: an image is missing, or the folder has scenarios already.
        InfrastructureError: a file cannot be written, or the backend cannot be reached.
    """
    folder.make_room()
    pending = {each.id: each for each in scenarios.pending}
    with temporary_folder(prefix=".scenarios-", parent=folder.output) as work:
        inputs = scenarios.write_inputs(work / "in")
        found = run_tasks(
            [folder.task(scenarios, number, inputs, work) for number in range(len(scenarios.pending))],
            work / "jobs",
            jobs,
            target,
            find=lambda name: folder.find(pending[name], scenarios.stillness),
            done=lambda count, total, judged: done(count, total, judged.result),
        )
    return list(found.values())


def _replace(source: Path, target: Path) -> None:
    """Move a folder, if it exists, to replace another one."""
    if target.exists():
        shutil.rmtree(target)
    if source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
