"""Worlds that are jobs in containers: judged one by one as they come, and kept; one that is lost loses no other."""

import shutil
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from calibration.errors import ExitCode, InputError, WorldError
from calibration.execution.backends import JobBackend
from calibration.execution.job import Job
from calibration.execution.job_folder import LOGS
from calibration.execution.outcome import JobOutcome
from calibration.pipeline.collection.scenarios import REPORT_FILES
from calibration.pipeline.collection.world_file import read_world, write_world
from calibration.simulation.scenarios.result import ScenarioResult

WORLDS = "worlds"
"""The folder of the datasets, a folder for each world in it."""


@dataclass(frozen=True)
class WorldJob:
    """A world, and the job that collects it."""

    unseen: ScenarioResult
    """What is known of it before it is run."""
    job: Job


@dataclass(frozen=True)
class Judged:
    """What a world's job is worth."""

    result: ScenarioResult
    error: ExitCode | None = None
    """Set where it could not be run: a wrong image (2), the engine, the host or the time (3)."""
    complete: bool = True
    """Whether there is nothing to gain from running it again."""


Judge = Callable[[ScenarioResult, JobOutcome, Path], Judged]
"""Called with a world, what came of its job, and a folder, which does not exist, for its dataset."""


@dataclass(frozen=True)
class Gathering:
    """Where worlds run, and where what they leave is kept."""

    backend: JobBackend
    output: Path
    workers: int | None = None
    """Jobs at once; None for as many as the backend holds."""
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

    def run(
        self,
        worlds: Sequence[WorldJob],
        judge: Judge,
        stillness: float | None,
        work: Path,
        done: Callable[[ScenarioResult], None] | None = None,
    ) -> tuple[list[ScenarioResult], dict[str, ExitCode]]:
        """Run what is missing of the worlds.

        Args:
            worlds: all of them.
            judge: what a job is worth.
            stillness: how far a pattern may move while the sensors look, m; None where nobody asks.
            work: a folder in the output folder, for what the jobs leave.
            done: called after each world; first with those that are kept.

        Returns:
            The results in the order of the worlds; and the exit codes of those that could not be run, by their ids.

        Raises:
            InputError: a job makes no sense, or an image is missing; nothing has been run.
            WorldError: the backend cannot be reached, or a file not be written.
        """
        found = {n: kept for n, world in enumerate(worlds) if (kept := self._kept(world.unseen, stillness)) is not None}
        if done:
            for kept in found.values():
                done(kept)
        errors: dict[str, ExitCode] = {}
        missing = [number for number in range(len(worlds)) if number not in found]
        if missing:
            jobs = [worlds[number].job for number in missing]
            with closing(self.backend.run(jobs, work / "jobs", self.workers)) as outcomes:
                for place, outcome in outcomes:
                    unseen = worlds[missing[place]].unseen
                    judged = self._take(unseen, outcome, judge, stillness, work / "new")
                    found[missing[place]] = judged.result
                    if judged.error is not None:
                        errors[unseen.id] = judged.error
                    if done:
                        done(judged.result)
        results = [found[number] for number in range(len(worlds))]
        return results, {each.id: errors[each.id] for each in results if each.id in errors}

    def _kept(self, unseen: ScenarioResult, stillness: float | None) -> ScenarioResult | None:
        """What an earlier run found of a world; None where it is missing, or was another one."""
        if not self.resume:
            return None
        try:
            return read_world(self.output / WORLDS / unseen.id, unseen, stillness)
        except InputError:
            return None

    def _take(
        self, unseen: ScenarioResult, outcome: JobOutcome, judge: Judge, stillness: float | None, new: Path
    ) -> Judged:
        """Judge a world, and keep what it left: all of it is there, or nothing."""
        try:
            judged = judge(unseen, outcome, new)
            _replace(outcome.folder / LOGS, self.output / LOGS / unseen.id)
            if judged.complete:
                write_world(judged.result, stillness, new)
                _replace(new, self.output / WORLDS / unseen.id)
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
