"""Collect a dataset in simulation, prove it by calibrating it, and judge both."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.errors import InputError, WorldError
from calibration.pipeline.collection.results import CollectionChecks, CollectionResults
from calibration.pipeline.collection.writing import write_collection_results

if TYPE_CHECKING:
    from calibration.simulation.collection.checks import Requirements
    from calibration.simulation.collection.play import Play
    from calibration.simulation.collection.record import Record
    from calibration.simulation.motion.sequence import Motion
    from calibration.simulation.system import System

MAX_POSES = 1000
"""No longer motion is generated."""
GENERATE = "generate:"

Done = Callable[[int, int, "Record"], None]
"""Called after each pose."""


@dataclass(frozen=True)
class CollectionRequest:
    """What is to be collected."""

    system: Path
    """The folder of a system."""
    robot: Path | None = None
    """Another robot description than the system's."""
    configuration: Path | None = None
    """Another calibration configuration than the system's."""
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    seed: int = 1
    requirements: "Requirements | None" = None
    checks: CollectionChecks = field(default_factory=CollectionChecks)


def collect_dataset(
    request: CollectionRequest,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    begin: Callable[["System", "Motion"], None] | None = None,
    done: Done | None = None,
) -> CollectionResults:
    """Collect a dataset into a folder, with its results beside it.

    An interrupted collection goes on where it was when it is asked for again.

    Args:
        request: what to collect.
        output: the folder; what it has besides a dataset stays.
        overwrite: whether a dataset that it has is replaced.
        jobs: processes; None for one a core.
        begin: called when everything was read and checked.
        done: called after each pose.

    Raises:
        InputError: an input is wrong, or the folder has a dataset and may not be overwritten.
        WorldError: a file cannot be written, or a process died; the folder's dataset is as it was.
    """
    from calibration.simulation.collection.dataset_folder import refuse_existing
    from calibration.simulation.collection.play import play
    from calibration.simulation.system import read_system

    refuse_existing(output, overwrite)
    system = read_system(request.system, request.robot, request.configuration)
    motion = read_or_generate(request, system)
    played = play(system, motion, request.seed)
    if begin:
        begin(system, motion)
    return collect_play(played, request.requirements, request.checks, output, overwrite, jobs, done)


def collect_play(
    played: "Play",
    requirements: "Requirements | None",
    checks: CollectionChecks,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    done: Done | None = None,
    world: str = "",
) -> CollectionResults:
    """Collect what a motion shows, as `collect_dataset` does.

    Args:
        played: the motion.
        requirements: what a collection has to keep to; None for the usual.
        checks: what the dataset has to keep to.
        output: the folder.
        overwrite: whether a dataset that it has is replaced.
        jobs: processes; None for one a core.
        done: called after each pose.
        world: what tells the world from the one that the system's files describe.

    Raises:
        InputError, WorldError: as `collect_dataset`.
    """
    require_opencv()
    from calibration.execution.workspace import workspace
    from calibration.simulation.collection.checks import Requirements
    from calibration.simulation.collection.collecting import collect, kept
    from calibration.simulation.collection.contact_sheet import write_contact_sheet
    from calibration.simulation.collection.dataset_folder import refuse_existing, replacing_dataset, write_dataset
    from calibration.simulation.collection.proof import prove
    from calibration.simulation.collection.record import Record

    refuse_existing(output, overwrite)
    requirements = requirements or Requirements()
    with workspace(output, _identity(played, requirements, world), Record.to_json, Record.from_json) as work:
        records = collect(played, requirements, work, jobs, done or (lambda *_: None))
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
                modalities=_modalities(played.system),
                records=tuple(records),
                proof=proof,
                limits=checks,
            )
            write_contact_sheet(new, played.system, records, work.folder)
            write_collection_results(results, new)
    return results


def require_opencv() -> None:
    """Say what to install where OpenCV, which draws and labels images, is missing.

    Raises:
        WorldError: it is.
    """
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        message = "collecting in simulation needs OpenCV: pip install opencv-python-headless"
        raise WorldError(message) from error


def _modalities(system: "System") -> dict[str, str]:
    return {name: sensor.modality for name, sensor in system.configuration.sensors.items()}


def read_or_generate(request: CollectionRequest, system: "System") -> "Motion":
    """The motion that a request names.

    Raises:
        InputError: it cannot be read or generated.
    """
    from calibration.simulation.motion.generation import generate_motion
    from calibration.simulation.motion.sequence import read_motion
    from calibration.simulation.system import MOTION_FILE

    if request.motion is None:
        path = request.system / MOTION_FILE
        if not path.exists():
            raise InputError(f"{path}: does not exist; give a motion: a file or {GENERATE}N")
        return read_motion(path)
    if not request.motion.startswith(GENERATE):
        return read_motion(Path(request.motion))
    return generate_motion(system, pose_count(request.motion), request.seed)


def pose_count(motion: str) -> int:
    """N of ``generate:N``.

    Raises:
        InputError: it is no number from 1 to `MAX_POSES`.
    """
    count = motion.removeprefix(GENERATE)
    if not (count.isascii() and count.isdigit() and len(count) < 10 and 1 <= int(count) <= MAX_POSES):
        raise InputError(f"motion: found '{motion}', expected {GENERATE}N with N from 1 to {MAX_POSES}")
    return int(count)


def _identity(played: "Play", requirements: "Requirements", world: str) -> str:
    """What the records of a collection depend on."""
    import json

    import cv2
    import numpy as np

    from calibration import __version__
    from calibration.execution.workspace import identity
    from calibration.simulation.motion.sequence import motion_document

    versions = f"{__version__} {np.__version__} {cv2.__version__} {played.seed} {requirements} {world}"
    motion = json.dumps(motion_document(played.motion))
    return identity(versions.encode(), motion.encode(), *played.system.sources.values())
