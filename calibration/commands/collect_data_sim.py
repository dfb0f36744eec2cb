"""``collect-data-sim``: collect a dataset of a system and a motion in simulation, and check it by calibrating it."""

import os
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import click

from calibration.base.errors import ExitCode, InputError
from calibration.base.files import write_atomically
from calibration.ci.execution.backends import CONTAINERS, DOCKER, EMBEDDED, KINDS, ExecutionTarget, check_backend
from calibration.ci.report import publish, show
from calibration.ci.workflow import Runner, stop_commands
from calibration.ci.workflow.progress import progress
from calibration.ci.workflow.streams import LogDisplay
from calibration.commands.collection_settings import (
    CollectionSettings,
    application_options,
    application_request,
    applications_entry,
    collection_request,
    scenario_image,
)
from calibration.commands.record_options import chosen, record_options
from calibration.commands.target import execution_target
from calibration.pipeline.collection import report, scenario_report
from calibration.pipeline.collection.dispatch import collect_dataset, collect_scenarios
from calibration.pipeline.collection.report import TITLE, pose_line
from calibration.pipeline.collection.request import (
    MAX_SCENARIOS,
    CollectionRequest,
    ContainerRequest,
    ScenarioRequest,
)
from calibration.pipeline.collection.scenario_report import scenario_line
from calibration.pipeline.collection.scenarios import ScenarioFolder
from calibration.pipeline.page.collection_page import collection_page
from calibration.pipeline.results import PAGE_FILE
from calibration.robot.simulation.collection.record import Record
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.system import System

MOST_SHOWN = 16
"""Limit of scenarios whose containers' logs are shown; with more, the logs are only in files."""


@click.command("collect-data-sim")
@record_options(CollectionSettings, required=True)
def command(**options: Any) -> ExitCode:
    """Collect a dataset in simulation: images, point clouds, labels and ground truth; and calibrate it."""
    settings = chosen(CollectionSettings, options)
    runner = Runner.from_environment(os.environ)
    return collect_data_sim(settings, runner)


def collect_data_sim(settings: CollectionSettings, runner: Runner) -> ExitCode:
    """Collect a dataset, or datasets of many scenarios; calibrate and report them.

    Raises:
        InputError: an input is missing or wrong, or the folder already contains a dataset.
        InfrastructureError: the folder cannot be written, or a process died; an existing dataset is unchanged.
    """
    entry = applications_entry(settings)
    backend = settings.backend or (str(entry.get("backend", DOCKER)) if entry else EMBEDDED)
    check_backend(backend)
    _check(settings, backend, applications=bool(entry))
    collection = application_request(settings, entry) if entry else collection_request(settings)
    if settings.scenarios is not None:
        return _many_scenarios(settings, settings.scenarios, collection, backend, runner)
    return _one_scenario(settings, collection, backend, runner)


def _check(settings: CollectionSettings, backend: str, applications: bool) -> None:
    """Refuse inconsistent settings.

    Raises:
        InputError: names the settings, and what to do.
    """
    containers = " or ".join(CONTAINERS)
    if settings.scenarios is not None and settings.checks.minimum_coverage is not None:
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
        if settings.resume and settings.scenarios is None and not KINDS[backend].resumes:
            lasting = " or ".join(name for name, kind in KINDS.items() if kind.resumes)
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
        return
    for name in ("image", "timeout", "run"):
        if getattr(settings, name) is not None:
            raise InputError(
                f"{name}: is for containers: give applications, or simulation-command and robot-command, or backend "
                f"{containers} with a scenario-set"
            )
    if settings.resume:
        raise InputError(f"resume: is for scenarios in containers: backend {containers}")


def _one_scenario(
    settings: CollectionSettings, request: CollectionRequest | ContainerRequest, backend: str, runner: Runner
) -> ExitCode:
    """Collect one dataset."""

    def begin(system: System, motion: Motion) -> None:
        scenario = "" if settings.scenario is None else f" in scenario {settings.scenario}"
        runner.log(f"{system.name}{scenario}: {len(motion)} poses of {motion.source}, seed {request.seed}")

    def done(count: int, total: int, record: Record) -> None:
        advance(count, total, pose_line(record), important=not record.kept)

    target, embedded = _target(settings, backend, runner), backend == EMBEDDED
    with (
        stop_commands(runner) if embedded else nullcontext(),  # names in files are untrusted
        progress(runner, TITLE, bar=embedded, kept="poses") as advance,
    ):
        results = collect_dataset(request, settings.output, settings.overwrite, settings.jobs, target, begin, done)
    found = report.report(results, settings.output)
    if settings.scenario is None:  # a scenario of many must have the same files wherever it is collected
        sheet = settings.output / report.CONTACT_SHEET if results.contact_sheet else None
        write_atomically(settings.output / PAGE_FILE, collection_page(found, sheet))
        found = replace(found, outputs={**found.outputs, "report": settings.output / PAGE_FILE})
    show(found, runner, settings.output)
    return found.exit_code


def _many_scenarios(
    settings: CollectionSettings,
    count: int,
    collection: CollectionRequest | ContainerRequest,
    backend: str,
    runner: Runner,
) -> ExitCode:
    """Collect many datasets, with one report."""
    applications = isinstance(collection, ContainerRequest)
    embedded = backend == EMBEDDED
    request = ScenarioRequest(
        collection,
        settings.scenario_set,
        count,
        settings.minimum_success_rate,
        application_options(settings) if applications else (),
        None if embedded or applications else scenario_image(settings, backend),
    )

    def begin(system: str, scenarios: int) -> None:
        of = "datasets of the applications" if applications else f"scenarios of {settings.scenario_set}"
        runner.log(f"{system}: {scenarios} {of}, seed {settings.seed}")

    def done(count: int, total: int, result: ScenarioResult) -> None:
        advance(count, total, scenario_line(result), important=not result.converged)

    target = _target(settings, backend, runner)
    if backend == DOCKER and count > MOST_SHOWN:
        target = replace(target, show=None)
    folder = ScenarioFolder(settings.output, settings.resume, settings.overwrite)
    with (
        stop_commands(runner) if embedded else nullcontext(),
        progress(runner, TITLE, bar=embedded, kept="scenarios" if embedded else "") as advance,
    ):
        results = collect_scenarios(request, folder, settings.jobs, target, begin, done)
    found = scenario_report.report(results, settings.output)
    publish(found, runner, settings.output)
    return found.exit_code


def _target(settings: CollectionSettings, backend: str, runner: Runner) -> ExecutionTarget:
    """Return the execution target of containers.

    Raises:
        InputError: the section of the cloud's settings is missing, or the name of the run to resume.
        InfrastructureError: the name of the run cannot be saved.
    """
    if backend == EMBEDDED:
        return ExecutionTarget()
    found = execution_target(backend, settings.aws_batch, settings.output, settings.run, settings.resume, runner)
    return replace(found, show=LogDisplay(runner))
