"""Collection by our own simulation or the team's applications: of one dataset, of many scenarios, and the stage."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from calibration.base import CalibrationError
from calibration.base.addons import import_attribute, of_addons
from calibration.ci.execution.backends import EMBEDDED
from calibration.ci.execution.supervision import BeginWatch
from calibration.ci.workflow.streams import progress
from calibration.pipeline.collection.by_applications import ApplicationScenarios, collect_by_applications
from calibration.pipeline.collection.by_simulation import Begin, PoseDone, SimulatedScenarios, collect_by_simulation
from calibration.pipeline.collection.report import pose_line
from calibration.pipeline.collection.request import CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import CollectionResults, ScenarioResults
from calibration.pipeline.collection.scenarios import ScenarioDone, ScenarioFolder, Scenarios, run_in_containers
from calibration.pipeline.results import Collected
from calibration.pipeline.running import COLLECTED_FOLDER, PipelineRun
from calibration.robot.simulation.dataset_folder import refuse_existing
from calibration.robot.simulation.record import Record
from calibration.robot.simulation.scenarios.statistics import Statistics

DRIVERS_SOUGHT = 5
"""Number of scenarios, of those beyond their error bars, that are repeated to find what drives the error."""
ScenariosBegin = Callable[[str, int], None]
"""Callback with the system's name and the number of scenarios, after everything was read and checked."""


def collect_dataset(
    request: CollectionRequest,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    begin: Begin = lambda *_: None,
    done: PoseDone = lambda *_: None,
) -> CollectionResults:
    """Collect a dataset into a folder, with its results beside it.

    An interrupted collection by our own simulation is continued by the same call; the result
    of a scenario of a set is also written to ``scenario.json``. A failure of the team's applications is a
    result, not an error; the logs of their containers are beside the dataset.

    Args:
        request: description of the collection.
        output: the folder; files other than a dataset are kept.
        overwrite: whether an existing dataset is replaced.
        jobs: number of processes of our own simulation; None for one per core.
        begin: called after everything was read and checked, only by our own simulation.
        done: called after each pose, only by our own simulation.

    Raises:
        InputError: an input is wrong, or the folder has a dataset that must not be overwritten.
        InfrastructureError: a file cannot be written, a process died, or there is no engine; the folder's dataset is
            unchanged.
    """
    refuse_existing(output, overwrite)
    if request.applications.containers:
        return collect_by_applications(request, output, overwrite)
    return collect_by_simulation(request, output, overwrite, jobs, begin, done)


def collect_scenarios(
    request: ScenarioRequest,
    folder: ScenarioFolder,
    jobs: int | None = None,
    begin: ScenariosBegin = lambda *_: None,
    done: ScenarioDone = lambda *_: None,
) -> ScenarioResults:
    """Collect, calibrate and judge the scenarios 0 to count - 1 of a seed.

    Scenarios of our own simulation run in local processes, and an interrupted run is continued; or, if
    the request has an image, in containers, like the team's applications. These also store the datasets in
    ``scenarios/ID/``, and the containers' logs in ``logs/ID/``.

    Args:
        request: description of the scenarios.
        folder: folder for the datasets and logs.
        jobs: number of parallel processes or containers; None for as many as the machine can run.
        begin: see `ScenariosBegin`.
        done: see `ScenarioDone`.

    Raises:
        InputError: an input is wrong, an image is missing, or the folder has scenarios already.
        InfrastructureError: a file cannot be written, a process died, or the backend cannot be reached.
    """
    collection = request.collection
    if collection.applications.containers:
        scenarios: Scenarios = ApplicationScenarios(collection, request.count)
    else:
        scenarios = SimulatedScenarios(request)
    begin(scenarios.system, request.count)
    if isinstance(scenarios, SimulatedScenarios) and not scenarios.image:
        found = scenarios.run(folder.output, jobs, done)
    else:
        found = run_in_containers(scenarios, folder, jobs, collection.target, done)
    errors = {each.result.id: each.error for each in found if each.error is not None}
    statistics = Statistics([each.result for each in found], lost=tuple(errors))
    worst = statistics.beyond_error_bars[:DRIVERS_SOUGHT]
    drivers = scenarios.drivers(worst, jobs) if isinstance(scenarios, SimulatedScenarios) else {}
    return ScenarioResults(scenarios.system, request, statistics, errors, drivers)


def collect_stage(run: PipelineRun) -> PipelineRun:
    """Collect datasets, each in its folder below the output folder, and calibrate them.

    A failed collection is stored in the results, and does not stop the others.
    """
    collections = tuple(_collect_one(request, run) for request in run.simulations)
    return replace(run, results=replace(run.results, collections=collections))


def _collect_one(request: CollectionRequest, run: PipelineRun) -> Collected:
    name, folder, begin = request.name, f"{COLLECTED_FOLDER}/{request.name}", time.perf_counter()
    try:
        target = replace(run.target, backend=request.backend or EMBEDDED, watch=_watch_of(request, run))
        request = replace(request, target=target)
        with progress(run.runner, f"collect {name}", bar=request.backend == EMBEDDED) as advance:

            def done(count: int, total: int, record: Record) -> None:
                advance(count, total, f"{name}: {pose_line(record)}", important=not record.kept)

            found = collect_dataset(request, run.output / folder, True, run.jobs, done=done)
    except CalibrationError as error:
        return Collected(name, reasons=(str(error),), error=error.exit_code)
    proof = found.proof
    return Collected(
        name=name,
        poses=len(found.records),
        kept=len(found.kept),
        corner_rms_px=found.corner_rms,
        rms_px=proof.rms_px if proof else None,
        translation_mm=proof.translation_mm if proof else None,
        rotation_deg=proof.rotation_deg if proof else None,
        dataset=folder if found.kept else None,
        reasons=tuple(found.reasons),
        error=found.error,
        seconds=round(time.perf_counter() - begin, 4),
    )


def _watch_of(request: CollectionRequest, run: PipelineRun) -> BeginWatch | None:
    """Return the watch of an add-on that follows what the containers say by rosbridge; None for none.

    Raises:
        CalibrationError: what it is to look for cannot be parsed, or a library is not installed.
    """
    recording = request.applications.record
    if recording is None or recording.rosbridge is None:
        return None
    for section, target in of_addons(lambda addon: addon.watches).items():
        settings = run.sections.of(section)
        watch: BeginWatch | None = settings and import_attribute(target)(settings, request.name, recording.rosbridge)
        if watch is not None:
            return watch
    run.runner.log(f"{request.name}: record.rosbridge: no section judges what this entry records: nothing is watched")
    return None
