"""Many datasets, of our own simulation's worlds or of the team's applications: run and judged."""

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from calibration.execution.backends import Place
from calibration.execution.tasks import Task, run_tasks
from calibration.execution.workspace import workspace
from calibration.pipeline.collection.application_worlds import ApplicationWorlds
from calibration.pipeline.collection.own_worlds import OwnWorlds
from calibration.pipeline.collection.request import ContainerRequest, ScenarioRequest
from calibration.pipeline.collection.scenarios import ScenarioResults
from calibration.pipeline.collection.world_folder import Judged, WorldFolder, Worlds
from calibration.records import read, text_of
from calibration.simulation.collection.collecting import single_threaded_opencv
from calibration.simulation.scenarios.scenario import ScenarioResult
from calibration.simulation.scenarios.statistics import Statistics

Begin = Callable[[str, int], None]
"""Called with the system's name and the number of worlds when everything was read and checked."""
Done = Callable[[int, int, ScenarioResult], None]
"""Called after each world; first with those that are done already."""


def run_worlds(
    request: ScenarioRequest,
    folder: WorldFolder,
    jobs: int | None = None,
    place: Place | None = None,
    begin: Begin = lambda *_: None,
    done: Done = lambda *_: None,
) -> ScenarioResults:
    """Run the worlds 0 to count - 1 of a seed.

    Worlds of our own simulation run in processes here, and one that is interrupted goes on where it was; or, where
    the request has an image, in containers, as the team's applications do. These leave the datasets too in
    ``worlds/ID/``, and the containers' logs in ``logs/ID/``.

    Args:
        request: which worlds.
        folder: for the datasets and logs.
        jobs: processes, or containers at once; None for as many as the machine holds.
        place: where containers run; this machine's engine unless given.
        begin: see `Begin`.
        done: see `Done`.

    Raises:
        InputError: an input is wrong, an image is missing, or the folder has worlds already.
        WorldError: a file cannot be written, a process died, or the place cannot be reached.
    """
    if isinstance(request.collection, ContainerRequest):
        worlds: Worlds = ApplicationWorlds(request.collection, request.count)
    else:
        worlds = OwnWorlds(request.collection, request)
    begin(worlds.system, request.count)
    if isinstance(worlds, OwnWorlds) and worlds.image is None:
        found = _run_here(worlds, folder.output, jobs, done)
    else:
        found = _run_in_containers(worlds, folder, jobs, place, done)
    errors = {each.result.id: each.error for each in found if each.error is not None}
    statistics = Statistics([each.result for each in found], lost=tuple(errors))
    return ScenarioResults(worlds.system, request, statistics, errors)


def _run_here(worlds: OwnWorlds, output: Path, jobs: int | None, done: Done) -> list[Judged]:
    with (
        workspace(output, worlds.identity, text_of, _decoded) as work,
        single_threaded_opencv(),
    ):
        tasks = [Task.call(each.id, partial(worlds.collect, number)) for number, each in enumerate(worlds.unseen)]
        found = run_tasks([work.keeping(task) for task in tasks], workers=jobs, find=work.find, done=done)
    return [Judged(result) for result in found.values()]


def _decoded(text: bytes) -> ScenarioResult:
    return read(ScenarioResult, json.loads(text), "a finished world")


def _run_in_containers(
    worlds: Worlds, folder: WorldFolder, jobs: int | None, place: Place | None, done: Done
) -> list[Judged]:
    folder.make_room()
    unseen = {each.id: each for each in worlds.unseen}
    with tempfile.TemporaryDirectory(prefix=".worlds-", dir=folder.output) as temporary:
        work = Path(temporary)
        inputs = worlds.write_inputs(work / "in")
        found = run_tasks(
            [folder.task(worlds, number, inputs, work) for number in range(len(worlds.unseen))],
            work / "jobs",
            jobs,
            place,
            find=lambda name: folder.find(unseen[name], worlds.stillness),
            done=lambda count, total, judged: done(count, total, judged.result),
        )
    return list(found.values())
