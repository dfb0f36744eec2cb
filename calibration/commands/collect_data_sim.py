"""``collect-data-sim``: collect a dataset of a system and a motion in simulation, and check it by calibrating it."""

import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import field as dataclass_field
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.base import ExitCode, InputError, read_yaml, with_variables, write_atomically
from calibration.base.records import Place, at_least, changed, field, read, record
from calibration.ci.execution.backends import (
    BACKEND_KINDS,
    CONTAINER_BACKENDS,
    DOCKER,
    EMBEDDED,
    ExecutionTarget,
    check_backend,
)
from calibration.ci.report import Report, publish, show
from calibration.ci.workflow import Runner, stop_commands
from calibration.ci.workflow.runner import OutputValue
from calibration.ci.workflow.streams import LogDisplay, progress
from calibration.commands.parameters import chosen, find_system, given, option_keys, record_options, system_folder
from calibration.commands.target import execution_target
from calibration.pipeline.collection import report, scenario_report
from calibration.pipeline.collection.collecting import collect_dataset, collect_scenarios
from calibration.pipeline.collection.report import COMMAND_NAME, collection_page, pose_line
from calibration.pipeline.collection.request import (
    MAX_SCENARIOS,
    CollectionLimits,
    CollectionRequest,
    ScenarioRequest,
    Share,
)
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.scenario_report import scenario_line
from calibration.pipeline.collection.scenarios import ScenarioFolder
from calibration.pipeline.containers import checked_applications
from calibration.pipeline.repetition.repetition import Repetition, Repetitions, repetition_of_collection
from calibration.pipeline.repetition.running import repeated, run_of_repetition
from calibration.pipeline.results import PAGE_FILE
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.record import Record
from calibration.robot.simulation.scenarios.scenario import ScenarioResult, parse_id
from calibration.robot.simulation.system import System

Tolerance = Annotated[float, at_least(0)]
OF_DATASET = ("robot", "config", "motion", "seed", "minimum-collections", "minimum-detection-rate", "minimum-coverage")
"""Keys of `CollectionRequest` that are options of every collection."""
OPTION_OF_KEY = {"config": "atom-config"}
"""Options of `CollectionRequest` whose names differ from its keys."""
OF_APPLICATIONS = ("image", "player", "ros", "truth", "timeout")
"""Keys of `CollectionRequest` that are options of collections in containers."""


@record(kw_only=True)
class CollectionSettings:
    """Inputs of ``collect-data-sim`` beside those of `CollectionRequest`."""

    system: str = field("Name of a system in datasets/, or the folder of one.")
    scenarios: Annotated[int, at_least(1)] | None = field(
        "Number of scenarios of the set, or of datasets of the applications.", default=None
    )
    scenario_set: Path | None = field("YAML file of the parameters that vary between scenarios.", default=None)
    scenario: str | None = field("Only this scenario, with its images: s1-00017 (seed 1, number 17).", default=None)
    minimum_success_rate: Share = field("Share of the scenarios that must pass, 0 to 1 (1).", default=1.0)
    max_translation_mm: Tolerance | None = field("Largest error against the truth, mm (5).", default=None)
    max_rotation_deg: Tolerance | None = field("Largest error against the truth, degrees (0.3).", default=None)
    stillness_mm: Tolerance | None = field("Largest movement of the pattern during a collection, mm (2).", default=None)
    backend: str | None = field("embedded, or containers on docker or aws-batch.", default=None)
    aws_batch: Path | None = field("YAML file with the section aws-batch (calibration.yml).", default=None)
    run_name: str | None = field(
        "Name of the run in containers or the cloud (a new one).", default=None, formerly="run"
    )
    resume: bool = field("Run only what is missing of an earlier run into this folder, or of this name.", default=False)
    applications: Path | None = field("YAML file of the team's applications, each in a container.", default=None)
    simulation_command: str | None = field(
        "Command of the simulation application, instead of a file of applications.", default=None
    )
    robot_command: str | None = field("Command of the robot application, which labels and saves.", default=None)
    parallel: Annotated[int, at_least(1)] | None = field(
        "Number of parallel processes or containers (one per core).", default=None, formerly="jobs"
    )
    output: Path = field("Folder for the dataset, or for the report on the scenarios.")
    overwrite: bool = field("Replace a dataset that the folder has.", default=False)
    keys: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Given keys of `CollectionRequest`."""


def collection_request(settings: CollectionSettings, applications: Mapping[str, Any]) -> CollectionRequest:
    """Return the request of the options.

    Args:
        settings: settings of the command.
        applications: description of the team's applications (`described_applications`); empty for our own simulation.

    Raises:
        InputError: the system does not exist, the description is wrong, or a container has no image.
    """
    if applications:
        request = _request_of_applications(settings, applications)
        used = {*OF_DATASET, "truth"}
    else:
        request = CollectionRequest(system_folder(settings.system), scenario_set=settings.scenario_set)
        used = {*OF_DATASET, "image", "timeout"}
    request = changed(request, {key: value for key, value in settings.keys.items() if key in used}, "options")
    checks = replace(request.checks, limits=_limits_of_truth(settings, request.checks.limits))
    stillness = None if settings.stillness_mm is None else settings.stillness_mm / 1000
    request = replace(request, checks=checks, stillness=stillness)
    if settings.scenario is None:
        return request
    seed, number = parse_id(settings.scenario)
    return replace(request, seed=seed, number=number)


def _request_of_applications(settings: CollectionSettings, applications: Mapping[str, Any]) -> CollectionRequest:
    where = str(settings.applications or "applications")
    folder = settings.applications.parent if settings.applications is not None else Path()
    system = find_system(settings.system)
    request = read(CollectionRequest, with_variables(applications, where), where, folder)
    checked = checked_applications(request.applications, Place(where))
    for container in checked.containers:
        if not container.image:
            raise InputError(f"{where}: containers.{container.name}: missing image (or give one for all)")
    return replace(request, applications=checked, system=system, name=system.name if system else settings.system)


def described_applications(settings: CollectionSettings) -> dict[str, Any]:
    """Return the description of applications in the options, as an entry ``simulation`` of calibration.yml, or empty.

    Raises:
        InputError: the file of the applications is wrong.
    """
    commands = {"simulation": settings.simulation_command, "robot": settings.robot_command}
    containers: dict[str, Any] = {
        name: {"command": command} for name, command in commands.items() if command is not None
    }
    if settings.applications is not None and containers:
        raise InputError("applications: excludes simulation-command and robot-command, which are part of the file")
    entry: dict[str, Any] = {"containers": containers} if containers else {}
    if "robot" in containers and "simulation" in containers:
        containers["robot"]["after"] = ["simulation"]
    if settings.applications is not None:
        document = read_yaml(settings.applications, "a description of applications")
        if not isinstance(document, dict) or "containers" not in document:
            raise InputError(f"{settings.applications}: expected a mapping with containers, as in calibration.yml")
        entry = document
    given = {key: settings.keys[key] for key in ("image", "player", "ros", "timeout") if key in settings.keys}
    for name in ("player", "ros"):
        if name in given and not entry:
            raise InputError(f"{name}: needs applications, or simulation-command and robot-command")
    return {**entry, **given} if entry else {}


def application_options(settings: CollectionSettings) -> tuple[str, ...]:
    """Return the options of the applications, for the command that reproduces one dataset."""
    commands = {"simulation-command": settings.simulation_command, "robot-command": settings.robot_command}
    given = {"applications": settings.applications, **commands} | {
        key: value for key, value in settings.keys.items() if key in OF_APPLICATIONS
    }
    return tuple(word for name, value in given.items() if value is not None for word in (f"--{name}", str(value)))


def _limits_of_truth(settings: CollectionSettings, limits: CollectionLimits) -> CollectionLimits:
    """Return the limits of the errors against the truth: those of the options, else of the applications' file."""
    given = {"translation_mm": settings.max_translation_mm, "rotation_deg": settings.max_rotation_deg}
    return replace(limits, **{name: limit for name, limit in given.items() if limit is not None})


MAX_SHOWN_LOGS = 16
"""Limit of scenarios whose containers' logs are shown; with more, the logs are only in files."""
_UNTIL_APPLICATIONS = tuple(
    key for key in option_keys(CollectionSettings) if key not in ("system", "parallel", "output", "overwrite")
)


@click.command("collect-data-sim")
@record_options(CollectionSettings, "system", required=True)
@record_options(CollectionRequest, "robot")
@record_options(CollectionRequest, "config", names=OPTION_OF_KEY, formerly="config")
@record_options(CollectionRequest, *OF_DATASET[2:])
@record_options(CollectionSettings, *_UNTIL_APPLICATIONS)
@record_options(CollectionRequest, *OF_APPLICATIONS)
@record_options(CollectionSettings, "parallel", "output", "overwrite", required=True)
@record_options(Repetitions)
def command(**options: Any) -> ExitCode:
    """Collect a dataset in simulation: images, point clouds, labels and ground truth; and calibrate it."""
    keys = given(CollectionRequest, options, *OF_DATASET, *OF_APPLICATIONS, names=OPTION_OF_KEY)
    settings = chosen(CollectionSettings, options, keys=keys)
    runner = Runner.from_environment()
    applications = described_applications(settings)
    backend = settings.backend or (str(applications.get("backend", DOCKER)) if applications else EMBEDDED)
    check_backend(backend)
    _check_settings(settings, backend, applications=bool(applications))
    request = collection_request(settings, applications)
    request = replace(request, target=_target_of(settings, backend, runner))
    repetitions = read(Repetitions, given(Repetitions, options), "options")
    if settings.scenarios is not None:
        if repetitions.repeat > 1:
            raise InputError("repeat: is for one dataset: with scenarios remove it")
        return _many_scenarios(settings, settings.scenarios, request, backend, runner)
    if repetitions.repeat > 1:
        return _repeated_collection(settings, repetitions, request, backend, runner)
    _, found = _one_scenario(settings, request, backend, runner)
    show(found, runner, settings.output)
    return found.exit_code


def _check_settings(settings: CollectionSettings, backend: str, applications: bool) -> None:
    """Refuse inconsistent settings.

    Raises:
        InputError: names the settings, and what to do.
    """
    containers = " or ".join(CONTAINER_BACKENDS)
    if settings.scenarios is not None and "minimum-coverage" in settings.keys:
        raise InputError("minimum-coverage: judges one dataset; with scenarios give minimum-detection-rate")
    if settings.scenarios is not None and settings.scenarios > MAX_SCENARIOS:
        raise InputError(f"scenarios: found {settings.scenarios}, expected {MAX_SCENARIOS} at most")
    if applications:
        if backend == EMBEDDED:
            raise InputError(f"backend: found {EMBEDDED}; applications run in containers: {containers}")
        if settings.scenario_set is not None:
            raise InputError("scenario-set: scenarios vary in our own simulation only; applications receive {scenario}")
        if settings.scenarios is not None and settings.scenario is not None:
            raise InputError("scenario: give either scenarios (how many) or scenario (the id of one)")
        if settings.resume and settings.scenarios is None and not BACKEND_KINDS[backend].resumes:
            lasting = " or ".join(name for name, kind in BACKEND_KINDS.items() if kind.resumes)
            raise InputError(
                f"resume: one dataset has no part that could be missing; with scenarios, or with {lasting}"
            )
        return
    scenarios = [asked for asked in (settings.scenarios, settings.scenario) if asked is not None]
    if settings.scenario_set is None and scenarios:
        raise InputError("scenarios and scenario need a scenario-set: a YAML file of the parameters that vary")
    if settings.scenario_set is not None and len(scenarios) != 1:
        raise InputError("scenario-set: give either scenarios (how many scenarios) or scenario (the id of one) with it")
    if backend != EMBEDDED:
        if settings.scenarios is None:
            raise InputError(
                f"backend: found {backend}; it runs the team's applications (applications, or image with "
                "simulation-command and robot-command), or many scenarios (image with scenario-set and scenarios)"
            )
        if "image" not in settings.keys:
            raise InputError(f"image: missing: {backend} runs every scenario in an image that has calibration-ci")
        return
    for name in ("image", "timeout", "run-name"):
        if name in settings.keys or (name == "run-name" and settings.run_name is not None):
            raise InputError(
                f"{name}: is for containers: give applications, or simulation-command and robot-command, or backend "
                f"{containers} with a scenario-set"
            )
    if settings.resume:
        raise InputError(f"resume: is for scenarios in containers: backend {containers}")


def _repeated_collection(
    settings: CollectionSettings,
    repetitions: Repetitions,
    request: CollectionRequest,
    backend: str,
    runner: Runner,
) -> ExitCode:
    """Collect one dataset, as often as it is asked for."""
    outputs: Mapping[str, OutputValue | None] = {}

    def once(folder: Path) -> Repetition:
        nonlocal outputs
        target = request.target and replace(request.target, run=run_of_repetition(request.target.run, folder))
        begin = time.perf_counter()
        results, found = _one_scenario(
            replace(settings, output=folder), replace(request, target=target), backend, runner
        )
        outputs = found.outputs
        return repetition_of_collection(results, found, folder, time.perf_counter() - begin)

    _, found = repeated(repetitions, settings.output, runner, "Repeated collection", once)
    show(replace(found, outputs={**outputs, **found.outputs}), runner, settings.output)
    return found.exit_code


def _one_scenario(
    settings: CollectionSettings, request: CollectionRequest, backend: str, runner: Runner
) -> tuple[CollectionResults, Report]:
    """Collect one dataset, and write its report, which is not shown yet."""

    def begin(system: System, motion: Motion) -> None:
        scenario = "" if settings.scenario is None else f" in scenario {settings.scenario}"
        runner.log(f"{system.name}{scenario}: {len(motion)} poses of {motion.source}, seed {request.seed}")

    def done(count: int, total: int, record: Record) -> None:
        advance(count, total, pose_line(record), important=not record.kept)

    embedded = backend == EMBEDDED
    with (
        stop_commands(runner) if embedded else nullcontext(),  # names in files are untrusted
        progress(runner, COMMAND_NAME, bar=embedded, kept="poses") as advance,
    ):
        results = collect_dataset(request, settings.output, settings.overwrite, settings.parallel, begin, done)
    found = report.report(results, settings.output)
    if settings.scenario is None:  # a scenario of many must have the same files wherever it is collected
        sheet = settings.output / report.CONTACT_SHEET if results.contact_sheet else None
        write_atomically(settings.output / PAGE_FILE, collection_page(found, sheet))
        found = replace(found, outputs={**found.outputs, "report": settings.output / PAGE_FILE})
    return results, found


def _many_scenarios(
    settings: CollectionSettings,
    count: int,
    collection: CollectionRequest,
    backend: str,
    runner: Runner,
) -> ExitCode:
    """Collect many datasets, with one report."""
    applications = bool(collection.applications.containers)
    embedded = backend == EMBEDDED
    request = ScenarioRequest(
        collection,
        count,
        settings.minimum_success_rate,
        application_options(settings) if applications else (),
    )

    def begin(system: str, scenarios: int) -> None:
        of = "datasets of the applications" if applications else f"scenarios of {settings.scenario_set}"
        runner.log(f"{system}: {scenarios} {of}, seed {collection.seed}")

    def done(count: int, total: int, result: ScenarioResult) -> None:
        advance(count, total, scenario_line(result), important=not result.converged)

    folder = ScenarioFolder(settings.output, settings.resume, settings.overwrite)
    with (
        stop_commands(runner) if embedded else nullcontext(),
        progress(runner, COMMAND_NAME, bar=embedded, kept="scenarios" if embedded else "") as advance,
    ):
        results = collect_scenarios(request, folder, settings.parallel, begin, done)
    return publish(scenario_report.report(results, settings.output), runner, settings.output)


def _target_of(settings: CollectionSettings, backend: str, runner: Runner) -> ExecutionTarget:
    """Return the execution target of containers.

    Raises:
        InputError: the section of the cloud's settings is missing, or the name of the run to resume.
        InfrastructureError: the name of the run cannot be saved.
    """
    if backend == EMBEDDED:
        return ExecutionTarget()
    found = execution_target(backend, settings.aws_batch, settings.output, settings.run_name, settings.resume, runner)
    many = settings.scenarios is not None and settings.scenarios > MAX_SHOWN_LOGS
    return found if backend == DOCKER and many else replace(found, show=LogDisplay(runner))
