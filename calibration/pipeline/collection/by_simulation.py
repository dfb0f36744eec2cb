"""Collection by our own simulation: one dataset, or many scenarios in local processes or in containers.

In a container, ``calibration collect-data-sim`` collects one scenario; the image has this package. Its result is not
trusted: the dataset is calibrated again here.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from calibration import __version__
from calibration.base import ExitCode, InputError, one_line, read_bytes, shorten, temporary_folder, write_atomically
from calibration.base.records import read, text_of
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Mount
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, LOGS_FOLDER, JobOutcome
from calibration.ci.execution.tasks import Task, identity, run_tasks, workspace
from calibration.pipeline.collection.report import report
from calibration.pipeline.collection.request import CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.scenarios import (
    SCENARIO_FILE,
    Judged,
    ScenarioDone,
    Scenarios,
    read_scenario,
    write_scenario,
)
from calibration.pipeline.containers import INPUT_FOLDER
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.dataset_folder import replacing_dataset, write_dataset
from calibration.robot.simulation.kinematics import Play, play
from calibration.robot.simulation.motion import GENERATED_PREFIX, Motion, motion_document
from calibration.robot.simulation.motion_generation import named_motion
from calibration.robot.simulation.proof import prove
from calibration.robot.simulation.record import Record, collect, kept, write_contact_sheet
from calibration.robot.simulation.scenarios.run import (
    calibrated_result,
    find_driver,
    finished_result,
    pending_result,
    run_scenario,
    scenario_play,
    world_assumptions,
)
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.scenario_set import read_scenario_set
from calibration.robot.simulation.system import MOTION_FILE, System, read_system

CONTAINER_NAME = "scenario"
"""Name of the container."""
DATASET_FOLDER = "dataset"
"""Name of its output folder."""
SET_FILE, MOTION_INPUT, SYSTEM_FOLDER = "scenarios.yml", "motion.json", "system"
"""Names in `INPUT_FOLDER`; the system's folder is inside the last one, by its own name."""
MAX_INPUT_BYTES = 64 * 1024**2
"""Limit of the size of a scenario set or a motion in bytes."""
_LOG_TAIL_BYTES = 4096

Begin = Callable[[System, Motion], None]
PoseDone = Callable[[int, int, Record], None]
"""Callback after each pose."""


def collect_by_simulation(
    request: CollectionRequest, output: Path, overwrite: bool, jobs: int | None, begin: Begin, done: PoseDone
) -> CollectionResults:
    """Collect a dataset, like `calibration.pipeline.collection.collecting.collect_dataset`.

    Raises:
        InputError: an input is wrong, or the folder has a dataset that must not be overwritten.
        InfrastructureError: a file cannot be written, or a process died; the folder's dataset is unchanged.
    """
    requirements = requirements_of(request)
    system = read_system(request.folder, request.robot, request.config)
    if request.scenario_set is None:
        played = play(system, required_motion(request, system), request.seed)
        begin(system, played.motion)
        return _collect_motion(played, request, requirements, output, overwrite, jobs, done)
    scenarios = read_scenario_set(request.scenario_set, system)
    motion = None if request.motion is None else required_motion(request, system)
    scenario = scenarios.scenario(request.seed, request.number)
    result = pending_result(scenarios, scenario, motion)
    try:
        played = scenario_play(scenarios, scenario, motion)
    except InputError as error:
        write_scenario(replace(result, reasons=(str(error),)), requirements.stillness, output)
        raise
    begin(played.system, played.motion)
    found = _collect_motion(played, request, requirements, output, overwrite, jobs, done, result.hash)
    write_scenario(finished_result(result, found.records, found.proof), requirements.stillness, output)
    return found


def required_motion(request: CollectionRequest, system: System) -> Motion:
    """Return the motion that our own simulation plays; a generated one uses the request's seed.

    Raises:
        InputError: it cannot be read or generated, or there is none.
    """
    path = request.folder / MOTION_FILE
    if request.motion is None and not path.exists():
        raise InputError(f"{path}: does not exist; give a motion: a file or {GENERATED_PREFIX}N")
    return named_motion(request.motion or str(path), system, request.seed)


def requirements_of(request: CollectionRequest) -> Requirements:
    """Return the requirements of each collection."""
    return Requirements() if request.stillness is None else Requirements(stillness=request.stillness)


def _collect_motion(
    played: Play,
    request: CollectionRequest,
    requirements: Requirements,
    output: Path,
    overwrite: bool,
    jobs: int | None,
    done: PoseDone,
    scenario: str = "",
) -> CollectionResults:
    """Collect the dataset of a motion; ``scenario`` identifies the scenario, empty for the system as described."""
    depends_on = _hash_of_inputs(played, requirements, scenario)
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
                limits=request.effective_checks,
            )
            write_contact_sheet(new, played.system, records, work.folder)
            report(results, new).write(new)
    return results


def _hash_of_inputs(played: Play, requirements: Requirements, scenario: str) -> str:
    """Return a hash of the inputs of a collection's records."""
    versions = f"{__version__} {np.__version__} {cv2.__version__} {played.seed} {requirements} {scenario}"
    motion = json.dumps(motion_document(played.motion))
    return identity(versions.encode(), motion.encode(), *played.system.sources.values())


class SimulatedScenarios(Scenarios):
    """Scenarios of a scenario set."""

    def __init__(self, request: ScenarioRequest) -> None:
        """Read the request's files, and draw the scenarios.

        Raises:
            InputError: one is missing or wrong, or no draw of a scenario satisfies the constraints.
        """
        collection = request.collection
        if collection.scenario_set is None:
            raise InputError("scenarios and scenario need a scenario-set: a YAML file of the parameters that vary")
        self.image = collection.applications.image
        self._collection = collection
        self._requirements = requirements_of(collection)
        self.stillness = self._requirements.stillness
        self._system = read_system(collection.folder, collection.robot, collection.config)
        self.system = self._system.name
        self._set_file = collection.scenario_set
        self._set = read_scenario_set(collection.scenario_set, self._system)
        self._motion = None if collection.motion is None else required_motion(collection, self._system)
        self._scenarios = [self._set.scenario(collection.seed, number) for number in range(request.count)]
        self.pending = [pending_result(self._set, scenario, self._motion) for scenario in self._scenarios]

    def run(self, output: Path, jobs: int | None, done: ScenarioDone) -> list[Judged]:
        """Collect and calibrate all scenarios in local processes; finished ones of an interrupted run are reused.

        Raises:
            InfrastructureError: a file cannot be written, or a process died.
        """
        resumed = workspace(output, self._hash_of_inputs, text_of, _scenario_result_from)
        with resumed as work, temporary_folder() as scratch:
            asked = self._motion, self._requirements, scratch
            tasks = [Task.call(each.id, partial(run_scenario, self._set, each, *asked)) for each in self._scenarios]
            found = run_tasks([work.keeping(task) for task in tasks], workers=jobs, find=work.find, done=done)
        return [Judged(result) for result in found.values()]

    def drivers(self, results: Sequence[ScenarioResult], jobs: int | None) -> dict[str, str]:
        """Return by id what drives the errors of scenarios, in local processes (`find_driver`).

        Raises:
            InfrastructureError: a file cannot be written, or a process died.
        """
        asked = self._motion, self._requirements
        tasks = [Task.call(each.id, partial(find_driver, self._set, each, *asked)) for each in results]
        return dict(run_tasks(tasks, workers=jobs))

    @property
    def _hash_of_inputs(self) -> str:
        """Return a hash of the inputs that all scenarios share."""
        versions = f"{__version__} {np.__version__} {cv2.__version__} {self._requirements}"
        motion = json.dumps(motion_document(self._motion)) if self._motion else ""
        content = read_bytes(self._set_file, MAX_INPUT_BYTES, "a scenario set")
        return identity(versions.encode(), motion.encode(), content, *self._system.sources.values())

    def write_inputs(self, folder: Path) -> Path:
        """Write the system, the set and the motion."""
        for name, content in self._system.sources.items():
            write_atomically(folder / SYSTEM_FOLDER / self.system / name, content)
        write_atomically(folder / SET_FILE, read_bytes(self._set_file, MAX_INPUT_BYTES, "a scenario set"))
        if (motion := self._motion_file) is not None:
            write_atomically(folder / MOTION_INPUT, read_bytes(motion, MAX_INPUT_BYTES, "a motion sequence"))
        return folder

    @property
    def _motion_file(self) -> Path | None:
        motion = self._collection.motion
        return None if motion is None or motion.startswith(GENERATED_PREFIX) else Path(motion)

    def job(self, number: int, inputs: Path | None) -> Job:
        """Return the job of a scenario."""
        of, name = self._collection, self.pending[number].id
        options = {
            "--system": f"{INPUT_FOLDER}/{SYSTEM_FOLDER}/{self.system}",
            "--scenario-set": f"{INPUT_FOLDER}/{SET_FILE}",
            "--scenario": name,
            "--output": f"{OUTPUT}/{DATASET_FOLDER}",
            "--jobs": "1",  # the scenarios run in parallel
        }
        if of.motion is not None:
            options["--motion"] = of.motion if self._motion_file is None else f"{INPUT_FOLDER}/{MOTION_INPUT}"
        if of.stillness is not None:
            options["--stillness-mm"] = repr(1000 * of.stillness)
        container = Container(
            name=CONTAINER_NAME,
            image=self.image,
            command=("calibration", "collect-data-sim", *(word for option in options.items() for word in option)),
            mounts=() if inputs is None else (Mount(inputs.resolve(), INPUT_FOLDER),),
            success=(
                ExitCode.PASS,
                ExitCode.FAIL,
                ExitCode.BAD_INPUT,
            ),  # the exit codes are explained in the scenario's file
            artifacts=(Artifact(f"{OUTPUT}/{DATASET_FOLDER}", required=False),),
        )
        return Job(name, (container,), seconds=of.applications.seconds)

    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a scenario by its job: its dataset is moved to ``new``, and calibrated."""
        known = self.pending[number]
        if outcome.exit_code != ExitCode.PASS:
            error = None if outcome.exit_code == ExitCode.FAIL else outcome.exit_code
            return Judged(replace(known, reasons=outcome.reasons), error, complete=False)
        brought = outcome.folder / ARTIFACTS_FOLDER / DATASET_FOLDER
        try:
            if not (brought / SCENARIO_FILE).exists():
                raise InputError(f"the image left no {SCENARIO_FILE} (it needs calibration-ci){_last_line(outcome)}")
            stored = read_scenario(brought, known, self.stillness)
        except InputError as error:
            return Judged(replace(known, reasons=(str(error),)), complete=False)
        brought.rename(new)
        result = replace(
            known, poses=stored.poses, lost=stored.lost, detection=stored.detection, corner_rms_px=stored.corner_rms_px
        )
        if stored.kept > 0:
            return Judged(calibrated_result(result, prove(new, assume=world_assumptions(self._set))))
        return Judged(replace(result, reasons=stored.reasons or ("no pose gave a collection",)))


def _scenario_result_from(text: bytes) -> ScenarioResult:
    return read(ScenarioResult, json.loads(text), "a finished scenario")


def _last_line(outcome: JobOutcome) -> str:
    """Return the last line of the container's log, for messages; empty if there is none."""
    try:
        with (outcome.folder / LOGS_FOLDER / f"{CONTAINER_NAME}.log").open("rb") as log:
            log.seek(max(0, log.seek(0, 2) - _LOG_TAIL_BYTES))
            lines = log.read(_LOG_TAIL_BYTES).decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    last = next((line for line in reversed(lines) if line.strip()), "")
    return f": {shorten(one_line(last), 300)}" if last else ""
