"""Entry points of the collection: one dataset, or many scenarios; by our own simulation or the team's applications."""

from collections.abc import Callable
from pathlib import Path

from calibration.pipeline.collection.by_applications import ApplicationScenarios, collect_by_applications
from calibration.pipeline.collection.by_simulation import Begin, PoseDone, SimulatedScenarios, collect_by_simulation
from calibration.pipeline.collection.request import CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import CollectionResults, ScenarioResults
from calibration.pipeline.collection.scenarios import ScenarioDone, ScenarioFolder, Scenarios, run_in_containers
from calibration.robot.simulation.dataset_folder import refuse_existing
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
