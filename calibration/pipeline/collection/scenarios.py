"""Many scenarios in containers: each is a job with an output folder, which is kept once it is complete.

The file ``scenario.json`` beside the dataset of a scenario has its result.
"""

import json
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from calibration import __version__
from calibration.base import (
    ExitCode,
    InputError,
    one_line,
    parse_json,
    read_bytes,
    temporary_folder,
    write_atomically,
    writing,
)
from calibration.base.records import document_of, field, length, read, record
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import LOGS_FOLDER, JobOutcome
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.pipeline.collection.scenario_report import REPORT_FILES
from calibration.robot.simulation.scenarios.scenario import Amount, ScenarioResult

SCENARIO_FILE = "scenario.json"
MAX_SCENARIO_FILE_BYTES = 16 * 1024**2


@record(case="snake", nulls=True)
class ScenarioFile:
    """Result of one scenario, beside its dataset."""

    schema: Literal[1] = field("Of this form.")
    version: Annotated[str, length(most=100)] = field("Version of the package that made it.")
    stillness_m: Amount | None = field(
        "How far the pattern may have moved while the sensors looked; null where the team's applications collected."
    )
    result: ScenarioResult = field("Result of the scenario.")


def write_scenario(result: ScenarioResult, stillness: float | None, folder: Path) -> None:
    """Write the file into the folder of the dataset.

    Args:
        result: result of the scenario.
        stillness: limit of a pattern's motion while the sensors measure, m; None if unknown.
        folder: the target folder.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = document_of(ScenarioFile(1, __version__, stillness, result))
    write_atomically(folder / SCENARIO_FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_scenario(folder: Path, expected: ScenarioResult, stillness: float | None) -> ScenarioResult:
    """Read the file of a scenario; its content is not trusted.

    Args:
        folder: the scenario's folder.
        expected: the expected scenario, without a result.
        stillness: limit of a pattern's motion, m.

    Raises:
        InputError: there is no such file, or it is of another scenario, another version or invalid.
    """
    path = folder / SCENARIO_FILE
    text = read_bytes(path, MAX_SCENARIO_FILE_BYTES, "what came of a scenario")
    try:
        document = parse_json(text)
    except (ValueError, RecursionError):
        raise InputError(f"{SCENARIO_FILE}: this is no JSON") from None
    found = read(ScenarioFile, document, SCENARIO_FILE)
    if found.version != __version__:
        raise InputError(
            f"{SCENARIO_FILE}: made by calibration-ci {one_line(found.version)}, this is {__version__}: "
            "another version makes other scenarios; have the same in the image"
        )
    for what, theirs, ours in (
        ("id", found.result.id, expected.id),
        ("hash", found.result.hash, expected.hash),
        ("stillness", found.stillness_m, stillness),
    ):
        if theirs != ours:
            raise InputError(f"{SCENARIO_FILE}: it is of another scenario: {what}: found {theirs}, expected {ours}")
    return found.result


SCENARIOS_FOLDER = "scenarios"
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
        place = self.output / SCENARIOS_FOLDER
        if place.exists() and not (self.resume or self.overwrite):
            raise InputError(
                f"{place}: exists already; --overwrite replaces the scenarios, --resume runs what is missing"
            )
        with writing(self.output):
            self.output.mkdir(parents=True, exist_ok=True)
            for name in REPORT_FILES:
                (self.output / name).unlink(missing_ok=True)
            if not self.resume:
                for folder in (place, self.output / LOGS_FOLDER):
                    if folder.exists():
                        shutil.rmtree(folder)

    def task(self, scenarios: Scenarios, number: int, inputs: Path | None, work: Path) -> Task[Judged]:
        """Return the task of a scenario.

        Args:
            scenarios: all scenarios.
            number: index of the scenario.
            inputs: the input folder of all jobs.
            work: a folder in the output folder, for incomplete results.
        """

        def judge(outcome: JobOutcome) -> Judged:
            return self._take_output(scenarios, number, outcome, work / "new")

        return Task.containers(scenarios.pending[number].id, scenarios.job(number, inputs), judge)

    def find(self, pending: ScenarioResult, stillness: float | None) -> Judged | None:
        """Return the result of a scenario in an earlier run; None if it is missing, or of another scenario."""
        if not self.resume:
            return None
        try:
            return Judged(read_scenario(self.output / SCENARIOS_FOLDER / pending.id, pending, stillness))
        except InputError:
            return None

    def _take_output(self, scenarios: Scenarios, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a scenario, and move its output into place as a whole."""
        name = scenarios.pending[number].id
        with writing(self.output):
            judged = scenarios.judge(number, outcome, new)
            _move_folder(outcome.folder / LOGS_FOLDER, self.output / LOGS_FOLDER / name)
            if judged.complete:
                write_scenario(judged.result, scenarios.stillness, new)
                _move_folder(new, self.output / SCENARIOS_FOLDER / name)
            for left in (new, outcome.folder):
                if left.exists():
                    shutil.rmtree(left)
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


def _move_folder(source: Path, target: Path) -> None:
    """Move a folder, if it exists, to replace another one."""
    if target.exists():
        shutil.rmtree(target)
    if source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
