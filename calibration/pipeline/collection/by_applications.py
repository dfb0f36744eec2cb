"""Collection by a team's applications: run them, copy their datasets, calibrate and judge them.

One dataset, or many, which the applications vary by ``{seed}`` and ``{scenario}``.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from calibration.base import (
    CalibrationError,
    ExitCode,
    InputError,
    one_line,
    parse_json,
    read_bytes,
    shorten,
    temporary_folder,
    write_atomically,
    writing,
)
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, LOGS_FOLDER, JobOutcome
from calibration.ci.execution.ros import MESSAGES_FOLDER, recorder_reasons
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.engine.dataset.model import CornerLabels, Dataset, label_count
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.evaluation.truth import TRUTH_FILE
from calibration.pipeline.collection.report import report
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.scenarios import Judged, Scenarios
from calibration.pipeline.containers import MOTION_PATH, PLAYER_PATH, REPORT_PATH, collection_job, dataset_place
from calibration.robot.simulation.dataset_folder import replacing_dataset, truth_document
from calibration.robot.simulation.kinematics import play
from calibration.robot.simulation.motion import GENERATED_PREFIX, PLAYER_FILE, Motion, check_motion, motion_document
from calibration.robot.simulation.motion_generation import named_motion
from calibration.robot.simulation.proof import prove
from calibration.robot.simulation.record import Record, image_cells, write_contact_sheet
from calibration.robot.simulation.scenarios.run import finished_result
from calibration.robot.simulation.scenarios.scenario import ScenarioResult, scenario_id
from calibration.robot.simulation.system import MOTION_FILE, System, read_system

MISSING_IMAGE = "missing"
"""Name of a missing image."""
MAX_REPORT_BYTES = 16 * 1024 * 1024
"""Limit of our player's report in bytes."""
_HASH_DIGITS = 12
JOB_NAME = "collection"
"""Name of the job of one dataset."""


@dataclass(frozen=True, eq=False)
class ApplicationPlan:
    """Request with its files read."""

    request: CollectionRequest
    system: System | None
    motion: Motion | None

    @property
    def name(self) -> str:
        """Name of the system."""
        return self.system.name if self.system else self.request.name

    def job(self, name: str, scenario: int, inputs: Path | None) -> Job:
        """Return the job of one collection; see `collection_job`."""
        request = self.request
        return collection_job(request.applications, name, self.name, request.seed, scenario, inputs)

    def dataset_name(self, scenario: int) -> str:
        """Return the name of the dataset's folder in the copied output."""
        request = self.request
        return PurePosixPath(dataset_place(request.applications, self.name, request.seed, scenario)).name


def collect_by_applications(request: CollectionRequest, output: Path, overwrite: bool) -> CollectionResults:
    """Collect a dataset, like `calibration.pipeline.collection.collecting.collect_dataset`.

    Raises:
        InputError: an input is missing or wrong, or the folder has a dataset that must not be overwritten.
        InfrastructureError: there is no backend, or a file cannot be written.
    """
    plan = read_plan(request)
    with replacing_dataset(output, overwrite) as new, temporary_folder(prefix=".job-", parent=output) as work:

        def judge(outcome: JobOutcome) -> CollectionResults:
            _keep_folder(outcome, LOGS_FOLDER, output)
            _keep_folder(outcome, f"{ARTIFACTS_FOLDER}/{MESSAGES_FOLDER}", output)
            return judged(plan, outcome, request.number, new)

        inputs = write_inputs(work / "in", plan)
        job = plan.job(JOB_NAME, request.number, inputs)
        return run_tasks([Task.containers(JOB_NAME, job, judge)], work, target=request.target)[JOB_NAME]


def read_plan(request: CollectionRequest) -> ApplicationPlan:
    """Read the system and the motion of a request.

    Raises:
        InputError: one is missing or wrong.
    """
    system = read_system(request.system, request.robot, request.config) if request.system else None
    motion = optional_motion(request, system)
    if request.applications.player is not None:
        if motion is None:
            raise InputError(f"{request.name}: our player needs a motion: a file, or a system with one")
        check_motion(motion)
    return ApplicationPlan(request, system, motion)


def optional_motion(request: CollectionRequest, system: System | None) -> Motion | None:
    """Return the motion for the team's applications; None if they have their own.

    Raises:
        InputError: it cannot be read or generated.
    """
    given = request.motion
    if given is None and request.system is not None and (request.system / MOTION_FILE).exists():
        given = str(request.system / MOTION_FILE)
    if given is not None and given.startswith(GENERATED_PREFIX) and system is None:
        raise InputError(f"{request.name}: motion: found '{given}', but a motion is only generated for a system")
    return None if given is None else named_motion(given, system, request.seed)


def write_inputs(folder: Path, plan: ApplicationPlan) -> Path | None:
    """Write the content of the containers' `INPUTS` into a new folder; None if there is none.

    Raises:
        InfrastructureError: it cannot be written.
    """
    if plan.motion is None:
        return None
    write_document(motion_document(plan.motion), folder / PurePosixPath(MOTION_PATH).name)
    if plan.request.applications.player is not None:
        write_atomically(folder / PurePosixPath(PLAYER_PATH).name, PLAYER_FILE.read_bytes())
    return folder


def _keep_folder(outcome: JobOutcome, name: str, output: Path) -> None:
    """Keep a folder of the job beside the dataset, and remove that of an earlier collection."""
    kept = output / PurePosixPath(name).name
    with writing(kept):
        shutil.rmtree(kept, ignore_errors=True)
        if (outcome.folder / name).is_dir():
            shutil.move(outcome.folder / name, kept)


def judged(plan: ApplicationPlan, outcome: JobOutcome, scenario: int, new: Path) -> CollectionResults:
    """Copy the output into a new folder, with the results beside it.

    Raises:
        InfrastructureError: a file cannot be written.
    """
    results = _results_of_output(plan, outcome, scenario, new)
    report(results, new).write(new)
    return results


def _results_of_output(plan: ApplicationPlan, outcome: JobOutcome, scenario: int, new: Path) -> CollectionResults:
    request = plan.request
    dataset, records, proof = None, [], None
    failures, error = outcome.reasons + recorder_reasons(outcome, request.applications.record), None
    if outcome.exit_code in (ExitCode.BAD_INPUT, ExitCode.INFRASTRUCTURE):
        error = outcome.exit_code
    if outcome.exit_code == ExitCode.PASS:
        brought = outcome.folder / ARTIFACTS_FOLDER / plan.dataset_name(scenario)
        try:
            dataset = read_dataset(brought)
            records = _records_of_poses(dataset, _read_player_report(outcome))
            _check_sensors(dataset, plan)
        except CalibrationError as problem:  # of files that the applications wrote: they have failed
            failures = (str(problem).replace(f"{brought}/", ""),)
    if dataset is not None and not failures:
        for path in sorted(brought.iterdir()):
            path.rename(new / path.name)
        _write_descriptions(plan, new)
        proof = prove(new, request.truth)
        if plan.system is not None:
            write_contact_sheet(new, plan.system, records, new)
    modalities: Mapping[str, str] = {s.name: s.modality.name for s in dataset.sensors.values()} if dataset else {}
    return CollectionResults(
        system=request.name,
        seed=request.seed,
        motion=plan.motion.source if plan.motion else "the motion of the applications",
        modalities=dict(modalities),
        records=tuple(records),
        proof=proof,
        limits=request.effective_checks,
        failures=tuple(failures),
        error=error,
        contact_sheet=proof is not None and plan.system is not None,
    )


def _check_sensors(dataset: Dataset, plan: ApplicationPlan) -> None:
    """Compare a dataset's sensors with those of the system.

    Raises:
        InputError: a sensor is missing, or its data.
    """
    for missing in map(dataset.missing_files_of, dataset.missing_files):
        raise InputError(f"dataset.json: {missing}")
    for name in plan.system.sensors if plan.system else ():
        if name not in dataset.sensors:
            raise InputError(f"dataset.json: missing sensor '{name}' (it has {', '.join(dataset.sensors)})")


def _write_descriptions(plan: ApplicationPlan, new: Path) -> None:
    """Add the files of the system, the motion and the truth to the dataset."""
    if plan.motion is not None:
        write_document(motion_document(plan.motion), new / MOTION_FILE)
    if plan.system is None:
        return
    for name, content in plan.system.sources.items():
        write_atomically(new / name, content)
    request = plan.request
    if plan.motion is not None and request.truth is None:
        write_document(truth_document(play(plan.system, plan.motion, request.seed), ()), new / TRUTH_FILE)


def _read_player_report(outcome: JobOutcome) -> list[dict[str, Any]]:
    """Read our player's report on each pose: its number, whether it was saved, the response; empty if it did not run.

    Raises:
        InputError: it is invalid; a container may have written it.
    """
    path = outcome.folder / ARTIFACTS_FOLDER / PurePosixPath(REPORT_PATH).name
    if not path.exists():
        return []
    try:
        report = parse_json(read_bytes(path, MAX_REPORT_BYTES, "the report of the player"))
        return [{"pose": int(p["pose"]), "saved": p["saved"] is True, "answer": str(p["answer"])} for p in report]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path.name}: this is no report of the player") from None


def _records_of_poses(dataset: Dataset, report: list[dict[str, Any]]) -> list[Record]:
    """Return a record for each collection, and for each pose that the robot application did not save."""
    saved = [pose["pose"] for pose in report if pose["saved"]]
    numbers = saved if len(saved) == len(dataset.collections) else list(range(1, len(dataset.collections) + 1))
    kept = [_record_of_collection(dataset, index, number - 1) for index, number in enumerate(numbers)]
    lost = [_record_of_lost_pose(dataset, pose["pose"] - 1, pose["answer"]) for pose in report if not pose["saved"]]
    return sorted([*kept, *lost], key=lambda record: record.number)


def _record_of_lost_pose(dataset: Dataset, number: int, answer: str) -> Record:
    reason = f"not saved: {shorten(one_line(answer), 200)}" if answer else "not saved"
    nothing = {"data": {name: {"data_file": MISSING_IMAGE} for name in dataset.sensors}, "labels": {}}
    return Record(number, (reason,), dict.fromkeys(dataset.sensors, 0), {}, {}, {}, nothing, {}, (), named="")


def _record_of_collection(dataset: Dataset, index: int, number: int) -> Record:
    """Return the record of a collection; the errors of its labels are unknown."""
    collection = dataset.collections[index]
    corners: dict[str, list[CornerLabels]] = {name: [] for name, s in dataset.sensors.items() if s.camera}
    labels, complete = dict.fromkeys(dataset.sensors, 0), dict.fromkeys(corners, False)
    for (pattern, sensor), found in collection.labels.items():
        if isinstance(found, CornerLabels):
            corners[sensor].append(found)
            complete[sensor] |= len(found.ids) == len(dataset.patterns[pattern].corners)
        labels[sensor] += label_count(found)
    cells = {
        name: image_cells(sensor.camera.width, sensor.camera.height, corners[name])
        for name, sensor in dataset.sensors.items()
        if sensor.camera and sensor.modality.has_corners
    }
    drawn = {"data": _data_files(dataset, index), "labels": _drawn_labels(dataset, index)}
    return Record(number, (), labels, complete, {}, cells, drawn, {}, (), named=collection.key)


def _data_files(dataset: Dataset, index: int) -> dict[str, dict[str, str]]:
    """Return the file of each sensor, for the contact sheet, without files outside of the dataset's folder."""
    data = dataset.document["collections"][dataset.keys[index]].get("data")
    names = {name: data[name].get("data_file") for name in dataset.sensors} if isinstance(data, dict) else {}
    inside = {n: f for n, f in names.items() if isinstance(f, str) and PurePosixPath(f).name == f}
    return {name: {"data_file": inside.get(name, MISSING_IMAGE)} for name in dataset.sensors}


def _drawn_labels(dataset: Dataset, index: int) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the labels of each pattern and sensor in the form of the contact sheet: corners only."""
    found = dataset.collections[index].labels

    def entries(pattern: str, sensor: str) -> list[dict[str, float]]:
        labels = found.get((pattern, sensor))
        if not isinstance(labels, CornerLabels):
            return []
        rows = zip(labels.ids.tolist(), labels.pixels.tolist(), strict=True)
        return [{"id": i, "x": x, "y": y} for i, (x, y) in rows]

    return {
        pattern: {s: {"idxs": entries(pattern, s), "idxs_limit_points": []} for s in dataset.sensors}
        for pattern in dataset.patterns
    }


class ApplicationScenarios(Scenarios):
    """Collections of a request."""

    stillness = None

    def __init__(self, request: CollectionRequest, count: int) -> None:
        """Read the request's files.

        Raises:
            InputError: one is missing or wrong.
        """
        self._plan = read_plan(request)
        self.system = self._plan.name
        names = [scenario_id(request.seed, number) for number in range(count)]
        self.pending = [
            ScenarioResult(name, _hash_of_collection(self._plan, self._plan.job(name, number, None)), {})
            for number, name in enumerate(names)
        ]

    def write_inputs(self, folder: Path) -> Path | None:
        """Write the motion and our player."""
        return write_inputs(folder, self._plan)

    def job(self, number: int, inputs: Path | None) -> Job:
        """Return the job of a collection."""
        return self._plan.job(self.pending[number].id, number, inputs)

    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """Judge a collection."""
        new.mkdir()
        _keep_folder(outcome, f"{ARTIFACTS_FOLDER}/{MESSAGES_FOLDER}", new)
        pending, results = self.pending[number], judged(self._plan, outcome, number, new)
        if results.failures:
            return Judged(replace(pending, reasons=results.failures), results.error, complete=results.error is None)
        return Judged(finished_result(pending, results.records, results.proof))


def _hash_of_collection(plan: ApplicationPlan, job: Job) -> str:
    """Return a hash that identifies a collection: of the containers and their inputs."""
    content = {
        "containers": [(container.name, container.image, container.command) for container in job.containers],
        "system": {name: hashlib.sha256(data).hexdigest() for name, data in plan.system.sources.items()}
        if plan.system
        else None,
        "motion": motion_document(plan.motion) if plan.motion else None,
    }
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]
