"""One dataset collected by our own simulation or by the team's applications, proven by calibrating it, and judged."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from calibration import __version__
from calibration.errors import InputError
from calibration.execution.backends import Place
from calibration.execution.workspace import identity, workspace
from calibration.pipeline.collection.application_dataset import collect_by_applications
from calibration.pipeline.collection.motion import required_motion
from calibration.pipeline.collection.report import report
from calibration.pipeline.collection.request import CollectionRequest, ContainerRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.world_file import write_world
from calibration.simulation.collection.capture import Requirements
from calibration.simulation.collection.collecting import collect, kept
from calibration.simulation.collection.contact_sheet import write_contact_sheet
from calibration.simulation.collection.dataset_folder import refuse_existing, replacing_dataset, write_dataset
from calibration.simulation.collection.proof import prove
from calibration.simulation.collection.record import Record
from calibration.simulation.motion.sequence import Motion, motion_document
from calibration.simulation.placement import Play, play
from calibration.simulation.scenarios.run import prepare, seen, unseen
from calibration.simulation.scenarios.scenario import parse_id
from calibration.simulation.scenarios.scenario_set import read_scenario_set
from calibration.simulation.system import System, read_system

Begin = Callable[[System, Motion], None]
Done = Callable[[int, int, Record], None]
"""Called after each pose."""


def collect_dataset(
    request: CollectionRequest | ContainerRequest,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    place: Place | None = None,
    begin: Begin = lambda *_: None,
    done: Done = lambda *_: None,
) -> CollectionResults:
    """Collect a dataset into a folder, with its results beside it.

    A collection by our own simulation that was interrupted goes on where it was when it is asked for again; of a world
    of a scenario set it is told in ``world.json`` too what came of it. What the team's applications do wrong is a
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
        WorldError: a file cannot be written, a process died, or there is no engine; the folder's dataset is as it was.
    """
    refuse_existing(output, overwrite)
    if isinstance(request, ContainerRequest):
        return collect_by_applications(request, output, place, overwrite)
    requirements = requirements_of(request)
    system = read_system(request.system, request.robot, request.configuration)
    if request.world is None:
        played = play(system, required_motion(request, system), request.seed)
        begin(system, played.motion)
        return _collected(played, request, requirements, output, overwrite, jobs, done)
    seed, index = parse_id(request.world.id)
    worlds = read_scenario_set(request.world.scenario_set, system)
    motion = None if request.motion is None else required_motion(request, system, seed)
    world = worlds.scenario(seed, index)
    result = unseen(worlds, world, motion)
    try:
        played = prepare(worlds, world, motion)
    except InputError as error:
        write_world(replace(result, reasons=(str(error),)), requirements.stillness, output)
        raise
    begin(played.system, played.motion)
    found = _collected(played, request, requirements, output, overwrite, jobs, done, result.hash)
    write_world(seen(result, found.records, found.proof), requirements.stillness, output)
    return found


def requirements_of(request: CollectionRequest) -> Requirements:
    """What each of its collections has to keep to."""
    return Requirements() if request.stillness is None else Requirements(stillness=request.stillness)


def _collected(
    played: Play,
    request: CollectionRequest,
    requirements: Requirements,
    output: Path,
    overwrite: bool,
    jobs: int | None,
    done: Done,
    world: str = "",
) -> CollectionResults:
    """Collect what a motion shows; ``world`` tells the world from the one that the system's files describe."""
    depends_on = _identity(played, requirements, world)
    with workspace(output, depends_on, Record.to_json, Record.from_json) as work:
        records = collect(played, requirements, work, jobs, done)
        good = kept(records)
        with replacing_dataset(output, overwrite) as new:
            proof = None
            if good:
                write_dataset(new, played, good, work.folder)
                proof = prove(new)
            results = CollectionResults(
                system=played.system.name,
                seed=played.seed,
                motion=played.motion.source,
                modalities={name: each.modality for name, each in played.system.configuration.sensors.items()},
                records=tuple(records),
                proof=proof,
                limits=request.checks,
            )
            write_contact_sheet(new, played.system, records, work.folder)
            report(results, new).write(new)
    return results


def _identity(played: Play, requirements: Requirements, world: str) -> str:
    """What the records of a collection depend on."""
    versions = f"{__version__} {np.__version__} {cv2.__version__} {played.seed} {requirements} {world}"
    motion = json.dumps(motion_document(played.motion))
    return identity(versions.encode(), motion.encode(), *played.system.sources.values())
