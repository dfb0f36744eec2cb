"""What worlds that ran in containers leave: a folder for each, kept one by one as they come."""

import shutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.errors import ExitCode, InputError, WorldError
from calibration.execution.job import Job
from calibration.execution.job_folder import LOGS
from calibration.execution.outcome import JobOutcome
from calibration.execution.tasks import Task
from calibration.pipeline.collection.scenario_report import REPORT_FILES
from calibration.pipeline.collection.world_file import read_world, write_world
from calibration.simulation.scenarios.scenario import ScenarioResult

WORLDS = "worlds"
"""The folder of the datasets, a folder for each world in it."""


@dataclass(frozen=True)
class Judged:
    """What a world's job is worth."""

    result: ScenarioResult
    error: ExitCode | None = None
    """Set where it could not be run: a wrong image (2), the engine, the host or the time (3)."""
    complete: bool = True
    """Whether there is nothing to gain from running it again."""


class Worlds(ABC):
    """The worlds of a request, its files read, as jobs of containers."""

    system: str
    unseen: Sequence[ScenarioResult]
    """What is known of each world before it is run."""
    stillness: float | None
    """How far a pattern may move while the sensors look, m; None where nobody asks."""

    @abstractmethod
    def write_inputs(self, folder: Path) -> Path | None:
        """Write what all jobs read into a new folder; None where they read nothing."""

    @abstractmethod
    def job(self, number: int, inputs: Path | None) -> Job:
        """The job of a world."""

    @abstractmethod
    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """What a world's job is worth; its dataset goes to a folder that does not exist."""


@dataclass(frozen=True)
class WorldFolder:
    """The output folder of many worlds."""

    output: Path
    resume: bool = False
    """Whether what an earlier run left is kept, and only what is missing is run."""
    overwrite: bool = False
    """Whether what an earlier run left is removed."""

    def make_room(self) -> None:
        """Make the output folder, without the report of an earlier run, and without its worlds if they are to go.

        Raises:
            InputError: there are worlds of an earlier run, and nobody has said what to do with them.
            WorldError: the folder cannot be written.
        """
        place = self.output / WORLDS
        if place.exists() and not (self.resume or self.overwrite):
            raise InputError(f"{place}: exists already; --overwrite replaces the worlds, --resume runs what is missing")
        try:
            self.output.mkdir(parents=True, exist_ok=True)
            for name in REPORT_FILES:
                (self.output / name).unlink(missing_ok=True)
            if not self.resume:
                for folder in (place, self.output / LOGS):
                    if folder.exists():
                        shutil.rmtree(folder)
        except OSError as error:
            raise WorldError(f"{self.output}: cannot be written: {error.strerror or error}") from error

    def task(self, worlds: Worlds, number: int, inputs: Path | None, work: Path) -> Task[Judged]:
        """The task of a world.

        Args:
            worlds: which it is one of.
            number: of the world.
            inputs: what all jobs read.
            work: a folder in the output folder, for what is not complete yet.
        """

        def judge(outcome: JobOutcome) -> Judged:
            return self._take(worlds, number, outcome, work / "new")

        return Task.containers(worlds.unseen[number].id, worlds.job(number, inputs), judge)

    def find(self, unseen: ScenarioResult, stillness: float | None) -> Judged | None:
        """What an earlier run found of a world; None where it is missing, or was another one."""
        if not self.resume:
            return None
        try:
            return Judged(read_world(self.output / WORLDS / unseen.id, unseen, stillness))
        except InputError:
            return None

    def _take(self, worlds: Worlds, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a world, and keep what it left: all of it is there, or nothing."""
        name = worlds.unseen[number].id
        try:
            judged = worlds.judge(number, outcome, new)
            _replace(outcome.folder / LOGS, self.output / LOGS / name)
            if judged.complete:
                write_world(judged.result, worlds.stillness, new)
                _replace(new, self.output / WORLDS / name)
            for left in (new, outcome.folder):
                if left.exists():
                    shutil.rmtree(left)
        except OSError as error:
            raise WorldError(f"{self.output}: cannot be written: {error.strerror or error}") from error
        return judged


def _replace(source: Path, target: Path) -> None:
    """Move a folder, if there is one, to the place of another."""
    if target.exists():
        shutil.rmtree(target)
    if source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
