"""Collect datasets: one, or many scenarios; by our own simulation or by the team's applications."""

from collections.abc import Callable
from pathlib import Path

from calibration.execution.backends import Place
from calibration.pipeline.collection.by_applications import ApplicationScenarios, collect_by_applications
from calibration.pipeline.collection.by_simulation import Begin, PoseDone, SimulatedScenarios, collect_by_simulation
from calibration.pipeline.collection.request import CollectionRequest, ContainerRequest, ScenarioRequest
from calibration.pipeline.collection.results import CollectionResults, ScenarioResults
from calibration.pipeline.collection.scenarios import ScenarioDone, ScenarioFolder, Scenarios, run_in_containers
from calibration.simulation.collection.dataset_folder import refuse_existing
from calibration.simulation.scenarios.statistics import Statistics

ScenariosBegin = Callable[[str, int], None]
"""Called with the system's name and the number of scenarios when everything was read and checked."""


def collect_dataset(
    request: CollectionRequest | ContainerRequest,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    place: Place | None = None,
    begin: Begin = lambda *_: None,
    done: PoseDone = lambda *_: None,
) -> CollectionResults:
    """Collect a dataset into a folder, with its results beside it.

    A collection by our own simulation that was interrupted goes on where it was when it is asked for again; the result
    of a scenario of a set is also written to ``scenario.json``. What the team's applications do wrong is a
    result, not an error; the logs of their containers stand beside the dataset.

    Args:
        request: what to collect.
        output: the folder; what it has besides a dataset stays.
        overwrite: whether a dataset that it has is replaced.
        jobs: processes of our own simulation; None for one a core.
        place: where the team's applications run; this machine's engine unless given.
        begin: called when everything was read and checked, of our own simulation.
        done: called after each pose of our own simulation.

    Raises:
        InputError: an input is wrong, or the folder has a dataset and may not be overwritten.
        InfrastructureError: a file cannot be written, a process died, or there is no engine; the folder's dataset is
            as it was.
    """
    refuse_existing(output, overwrite)
    if isinstance(request, ContainerRequest):
        return collect_by_applications(request, output, place, overwrite)
    return collect_by_simulation(request, output, overwrite, jobs, begin, done)


def collect_scenarios(
    request: ScenarioRequest,
    folder: ScenarioFolder,
    jobs: int | None = None,
    place: Place | None = None,
    begin: ScenariosBegin = lambda *_: None,
    done: ScenarioDone = lambda *_: None,
) -> ScenarioResults:
    """Collect, calibrate and judge the scenarios 0 to count - 1 of a seed.

    Scenarios of our own simulation run in processes here, and one that is interrupted goes on where it was; or, where
    the request has an image, in containers, as the team's applications do. These leave the datasets too in
    ``scenarios/ID/``, and the containers' logs in ``logs/ID/``.

    Args:
        request: which scenarios.
        folder: for the datasets and logs.
        jobs: processes, or containers at once; None for as many as the machine holds.
        place: where containers run; this machine's engine unless given.
        begin: see `ScenariosBegin`.
        done: see `ScenarioDone`.

    Raises:
        InputError: an input is wrong, an image is missing, or the folder has scenarios already.
        InfrastructureError: a file cannot be written, a process died, or the place cannot be reached.
    """
    if isinstance(request.collection, ContainerRequest):
        scenarios: Scenarios = ApplicationScenarios(request.collection, request.count)
    else:
        scenarios = SimulatedScenarios(request.collection, request)
    begin(scenarios.system, request.count)
    if isinstance(scenarios, SimulatedScenarios) and scenarios.image is None:
        found = scenarios.run(folder.output, jobs, done)
    else:
        found = run_in_containers(scenarios, folder, jobs, place, done)
    errors = {each.result.id: each.error for each in found if each.error is not None}
    statistics = Statistics([each.result for each in found], lost=tuple(errors))
    return ScenarioResults(scenarios.system, request, statistics, errors)
