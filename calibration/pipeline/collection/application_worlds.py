"""Many collections by the team's applications: ``{seed}`` and ``{scenario}`` tell them what to make different."""

import hashlib
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.execution.job import Job
from calibration.execution.outcome import JobOutcome
from calibration.pipeline.collection.applications import write_inputs
from calibration.pipeline.collection.collecting import require_opencv
from calibration.pipeline.collection.gathering_worlds import Gathering, Judged, WorldJob
from calibration.pipeline.collection.in_containers import Plan, judged, read_plan
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.scenarios import ScenarioRequest, ScenarioResults, write_scenario_results

if TYPE_CHECKING:
    from calibration.simulation.scenarios.result import ScenarioResult

_HASH_DIGITS = 12


def run_application_worlds(
    request: ScenarioRequest,
    gathering: Gathering,
    begin: Callable[[str, int], None] | None = None,
    done: "Callable[[ScenarioResult], None] | None" = None,
) -> ScenarioResults:
    """Collect with the team's applications as often as is asked, with one report over all.

    The datasets are left in ``worlds/ID/``, the containers' logs in ``logs/ID/``.

    Args:
        request: how often, and what the applications are.
        gathering: where they run, and where to what they leave goes.
        begin: called with the system's name and the number of collections when everything was read and checked.
        done: called after each collection that is run.

    Raises:
        InputError: an input is wrong, an image is missing, or the folder has worlds already.
        WorldError: the backend cannot be reached, or a file not be written.
    """
    require_opencv()
    from calibration.simulation.scenarios.report import Report
    from calibration.simulation.scenarios.scenario import parse_id

    plan = read_plan(request.theirs)
    if begin:
        begin(plan.name, request.count)
    gathering.make_room()
    with tempfile.TemporaryDirectory(prefix=".worlds-", dir=gathering.output) as work:
        inputs = write_inputs(Path(work, "in"), request.theirs.applications, plan.motion)
        worlds = [_world(plan, index, inputs) for index in range(request.count)]

        def judge(unseen: "ScenarioResult", outcome: JobOutcome, new: Path) -> Judged:
            new.mkdir()
            return _judged(unseen, judged(plan, outcome, parse_id(unseen.id)[1], new))

        found, errors = gathering.run(worlds, judge, None, Path(work), done)
    results = ScenarioResults(plan.name, request, Report(found, lost=tuple(errors)), errors=errors)
    return write_scenario_results(results, gathering.output)


def _world(plan: Plan, index: int, inputs: Path | None) -> WorldJob:
    from calibration.simulation.scenarios.result import ScenarioResult
    from calibration.simulation.scenarios.scenario import scenario_id

    name = scenario_id(plan.request.seed, index)
    job = plan.job(name, index, inputs)
    return WorldJob(ScenarioResult(name, _hash(plan, job), {}), job)


def _hash(plan: Plan, job: Job) -> str:
    """What tells two collections apart: what runs, and on what."""
    from calibration.simulation.motion.sequence import motion_document

    content = {
        "containers": [(container.name, container.image, container.command) for container in job.containers],
        "system": {name: hashlib.sha256(data).hexdigest() for name, data in plan.system.sources.items()}
        if plan.system
        else None,
        "motion": motion_document(plan.motion) if plan.motion else None,
    }
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]


def _judged(unseen: "ScenarioResult", results: CollectionResults) -> Judged:
    from calibration.simulation.scenarios.run import seen

    if results.error is not None:
        return Judged(replace(unseen, reasons=results.failures), results.error, complete=False)
    if results.failures:
        return Judged(replace(unseen, reasons=results.failures))
    return Judged(seen(unseen, results.records, results.proof))
