"""Our simulation's worlds in containers: in each, ``calibration collect-data-sim`` collects one of them.

The image has this package. What it says of a world is not taken on trust: its dataset is calibrated here again.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.errors import ExitCode, InputError
from calibration.execution.job import OUTPUT, Artifact, Container, Job, Mount
from calibration.execution.job_folder import ARTIFACTS, LOGS
from calibration.execution.outcome import JobOutcome
from calibration.files import read_bytes, write_atomically
from calibration.pipeline.collection.applications import INPUTS, SECONDS
from calibration.pipeline.collection.collecting import GENERATE, CollectionRequest, read_or_generate, require_opencv
from calibration.pipeline.collection.gathering_worlds import Gathering, Judged, WorldJob
from calibration.pipeline.collection.scenarios import ScenarioRequest, ScenarioResults, write_scenario_results
from calibration.pipeline.collection.world_file import FILE, read_world
from calibration.workflow.text import one_line, shorten

if TYPE_CHECKING:
    from calibration.simulation.scenarios.result import ScenarioResult
    from calibration.simulation.system import System

WORLD = "world"
"""The name of the container."""
DATASET = "dataset"
"""The name of the folder that it leaves."""
SET_FILE, MOTION_FILE, SYSTEM_FOLDER = "scenarios.yml", "motion.json", "system"
"""In `INPUTS`; the system's folder is in the last, by its own name."""
MAX_INPUT = 64 * 1024**2
"""Bytes of a scenario set or a motion."""
_TAIL = 4096


@dataclass(frozen=True)
class WorldImage:
    """What every world runs in."""

    image: str
    seconds: float = SECONDS
    """A world that takes longer is stopped."""


def run_worlds_in_containers(
    request: ScenarioRequest,
    image: WorldImage,
    gathering: Gathering,
    begin: Callable[[str, int], None] | None = None,
    done: "Callable[[ScenarioResult], None] | None" = None,
) -> ScenarioResults:
    """Run the worlds 0 to count - 1 of a seed as `calibration.pipeline.collection.scenarios.run_worlds` does.

    The same report is left, and beside it the datasets in ``worlds/ID/`` and the logs in ``logs/ID/``.

    Args:
        request: which worlds.
        image: what they run in.
        gathering: where they run, and where to what they leave goes.
        begin: called with the system's name and the number of worlds when everything was read and checked.
        done: called after each world that is run.

    Raises:
        InputError: an input is wrong, the image is missing, or the folder has worlds already.
        WorldError: the backend cannot be reached, or a file not be written.
    """
    require_opencv()
    from calibration.simulation.collection.checks import Requirements
    from calibration.simulation.scenarios.report import Report
    from calibration.simulation.scenarios.run import unseen
    from calibration.simulation.scenarios.scenario_set import read_scenario_set
    from calibration.simulation.system import read_system

    of = request.own
    system = read_system(of.system, of.robot, of.configuration)
    worlds = read_scenario_set(request.set_file, system)
    motion = None if of.motion is None else read_or_generate(of, system)
    results = [unseen(worlds, worlds.scenario(of.seed, index), motion) for index in range(request.count)]
    if begin:
        begin(system.name, request.count)
    gathering.make_room()
    stillness = (of.requirements or Requirements()).stillness
    with tempfile.TemporaryDirectory(prefix=".worlds-", dir=gathering.output) as work:
        inputs = _write_inputs(Path(work, "in"), request, system)
        jobs = [WorldJob(each, _job(each.id, request, system, image, inputs)) for each in results]

        def judge(each: "ScenarioResult", outcome: JobOutcome, new: Path) -> Judged:
            return _judged(each, outcome, new, stillness)

        found, errors = gathering.run(jobs, judge, stillness, Path(work), done)
    report = Report(found, lost=tuple(errors))
    return write_scenario_results(ScenarioResults(system.name, request, report, errors=errors), gathering.output)


def _write_inputs(folder: Path, request: ScenarioRequest, system: "System") -> Path:
    """Write what all worlds need into a new folder, their `INPUTS`."""
    for name, content in system.sources.items():
        write_atomically(folder / SYSTEM_FOLDER / system.name / name, content)
    write_atomically(folder / SET_FILE, read_bytes(request.set_file, MAX_INPUT, "a scenario set"))
    if (motion := _motion_file(request.own)) is not None:
        write_atomically(folder / MOTION_FILE, read_bytes(motion, MAX_INPUT, "a motion sequence"))
    return folder


def _motion_file(request: CollectionRequest) -> Path | None:
    return None if request.motion is None or request.motion.startswith(GENERATE) else Path(request.motion)


def _job(scenario: str, request: ScenarioRequest, system: "System", image: WorldImage, inputs: Path) -> Job:
    """The job of one world."""
    of = request.own
    options = {
        "--system": f"{INPUTS}/{SYSTEM_FOLDER}/{system.name}",
        "--scenario-set": f"{INPUTS}/{SET_FILE}",
        "--scenario": scenario,
        "--output": f"{OUTPUT}/{DATASET}",
        "--jobs": "1",  # the worlds are the parallel ones
    }
    if of.motion is not None:
        options["--motion"] = of.motion if _motion_file(of) is None else f"{INPUTS}/{MOTION_FILE}"
    if of.requirements is not None:
        options["--stillness-mm"] = repr(1000 * of.requirements.stillness)
    container = Container(
        name=WORLD,
        image=image.image,
        command=("calibration", "collect-data-sim", *(word for option in options.items() for word in option)),
        mounts=(Mount(inputs.resolve(), INPUTS),),
        success=(ExitCode.PASS, ExitCode.FAIL, ExitCode.BAD_INPUT),  # what these mean is in the file of the world
        artifacts=(Artifact(f"{OUTPUT}/{DATASET}", required=False),),
    )
    return Job(scenario, (container,), seconds=image.seconds)


def _judged(unseen: "ScenarioResult", outcome: JobOutcome, new: Path, stillness: float) -> Judged:
    """What a world's job is worth: its dataset is moved to ``new``, and calibrated."""
    from calibration.simulation.collection.proof import prove
    from calibration.simulation.scenarios.run import proven

    if outcome.exit_code != ExitCode.PASS:
        error = None if outcome.exit_code == ExitCode.FAIL else outcome.exit_code
        return Judged(replace(unseen, reasons=outcome.reasons), error, complete=False)
    brought = outcome.folder / ARTIFACTS / DATASET
    try:
        if not (brought / FILE).exists():
            raise InputError(f"the image left no {FILE} (it needs calibration-ci){_last_line(outcome)}")
        said = read_world(brought, unseen, stillness)
    except InputError as error:
        return Judged(replace(unseen, reasons=(str(error),)), complete=False)
    brought.rename(new)
    result = replace(
        unseen, poses=said.poses, lost=said.lost, detection=said.detection, corner_rms_px=said.corner_rms_px
    )
    if said.kept > 0:
        return Judged(proven(result, prove(new)))
    return Judged(replace(result, reasons=said.reasons or ("no pose gave a collection",)))


def _last_line(outcome: JobOutcome) -> str:
    """What the container said last, for a message; nothing where it said nothing."""
    try:
        with (outcome.folder / LOGS / f"{WORLD}.log").open("rb") as log:
            log.seek(max(0, log.seek(0, 2) - _TAIL))
            lines = log.read(_TAIL).decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    last = next((line for line in reversed(lines) if line.strip()), "")
    return f": {shorten(one_line(last), 300)}" if last else ""
