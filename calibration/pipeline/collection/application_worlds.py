"""Many collections by the team's applications: ``{seed}`` and ``{scenario}`` tell them what to make different."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome
from calibration.pipeline.collection.application_dataset import Plan, judged, read_plan, write_inputs
from calibration.pipeline.collection.request import ContainerRequest
from calibration.pipeline.collection.world_folder import Judged, Worlds
from calibration.simulation.motion.sequence import motion_document
from calibration.simulation.scenarios.run import seen
from calibration.simulation.scenarios.scenario import ScenarioResult, scenario_id

_HASH_DIGITS = 12


class ApplicationWorlds(Worlds):
    """The collections of a request."""

    stillness = None

    def __init__(self, request: ContainerRequest, count: int) -> None:
        """Read the request's files.

        Raises:
            InputError: one is missing or wrong.
        """
        self._plan = read_plan(request)
        self.system = self._plan.name
        names = [scenario_id(request.seed, number) for number in range(count)]
        self.unseen = [
            ScenarioResult(name, _hash(self._plan, self._plan.job(name, number, None)), {})
            for number, name in enumerate(names)
        ]

    def write_inputs(self, folder: Path) -> Path | None:
        """Write the motion and our player."""
        return write_inputs(folder, self._plan)

    def job(self, number: int, inputs: Path | None) -> Job:
        """The job of a collection."""
        return self._plan.job(self.unseen[number].id, number, inputs)

    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """What a collection is worth."""
        new.mkdir()
        unseen, results = self.unseen[number], judged(self._plan, outcome, number, new)
        if results.failures:
            return Judged(replace(unseen, reasons=results.failures), results.error, complete=results.error is None)
        return Judged(seen(unseen, results.records, results.proof))


def _hash(plan: Plan, job: Job) -> str:
    """What tells two collections apart: what runs, and on what."""
    content = {
        "containers": [(container.name, container.image, container.command) for container in job.containers],
        "system": {name: hashlib.sha256(data).hexdigest() for name, data in plan.system.sources.items()}
        if plan.system
        else None,
        "motion": motion_document(plan.motion) if plan.motion else None,
    }
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]
