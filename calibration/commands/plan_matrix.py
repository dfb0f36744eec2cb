"""``plan-matrix``: plan the jobs of the reusable workflow, in its first job."""

import os
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import click

from calibration.base.errors import ExitCode, InputError
from calibration.base.files import write_atomically
from calibration.base.records import read
from calibration.ci.services import event_of
from calibration.ci.workflow import Runner, set_outputs, stop_commands
from calibration.ci.workflow.runner import Event
from calibration.commands.parameters import (
    DEFAULT_ARTIFACT_NAME,
    PATH_LIST,
    TEXT_LIST,
    artifact_name,
    boolean_option,
    given,
    non_negative,
    path,
    record_options,
    text,
)
from calibration.pipeline.configuration import DEFAULT_FILE, PipelineConfiguration, read_configuration
from calibration.pipeline.distribution.plan import (
    JobInputs,
    WorkflowPlan,
    datasets_as_configuration,
    plan_jobs,
    plan_outputs,
    plan_text,
)
from calibration.pipeline.system import Noise

NOISE_OPTION_OF_KEY = {"translation": "translation-noise", "rotation": "rotation-noise"}
MAX_MINUTE_RATE = 1000.0
"""Limit of the price of a minute, in any currency, to find typing errors."""


@dataclass(frozen=True)
class PlanSettings:
    """Inputs of ``plan-matrix``; for None the configuration or its default applies."""

    config: Path | None = None
    datasets: tuple[Path, ...] = ()
    systems: tuple[str, ...] = ()
    noise: Noise = field(default_factory=Noise)
    noise_inside_cells: bool | None = None
    image: str | None = None
    command: str | None = None
    tests: str | None = None
    analyse: bool = False
    jobs: tuple[str, ...] = ()
    promote: bool = True
    minute_rate: float | None = None
    artifact_name: str = DEFAULT_ARTIFACT_NAME
    plan_file: Path | None = None


def minute_rate(value: str | float) -> float:
    """Parse the price of a minute; a usage error if it is not a price."""
    rate = non_negative(value)
    if rate > MAX_MINUTE_RATE:
        raise click.BadParameter(f"{value!r} is above {MAX_MINUTE_RATE:g}")
    return rate


@click.command("plan-matrix")
@click.option("--config", type=path, help="The configuration (calibration.yml).")
@click.option("--datasets", type=PATH_LIST, help="Datasets, each a system; instead of config.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems.")
@record_options(
    Noise,
    names=NOISE_OPTION_OF_KEY,
    helps={"seeds": "How many seeds for each pair of noises (1); always inside a job."},
)
@boolean_option(
    "--noise-inside-cells",
    default=None,
    help="Calibrate a system from all its noises in one job (if that takes about a minute).",
)
@click.option("--image", type=text, help="Image with the team's own calibration.")
@click.option("--command", type=text, help="Command of this image.")
@click.option("--tests", type=text, help="The command that runs the unit tests.")
@boolean_option("--analyse", default=False, help="Analyse the code of the repository (no).")
@click.option("--jobs", type=TEXT_LIST, help="Only these jobs: calibrate, collect-data, unit-tests, static-analysis.")
@boolean_option("--promote", default=True, help="An image that passes may get its release tags (yes).")
@click.option("--minute-rate", type=minute_rate, help="Price of a minute of a job, in your currency: 0.006.")
@click.option("--artifact-name", type=artifact_name, help="Prefix of the artifact names (calibration).")
@click.option("--plan-file", type=path, help="File for the plan, which gather-results reads.")
def command(**options: Any) -> ExitCode:
    """Plan the jobs of a workflow: one for each system and pair of noises, as the matrix of a GitHub job."""
    own = {each.name: value for each in fields(PlanSettings) if (value := options.get(each.name)) is not None}
    settings = PlanSettings(**own, noise=read(Noise, given(Noise, options, names=NOISE_OPTION_OF_KEY), "options"))
    return plan_matrix(settings, Runner.from_environment(os.environ))


def plan_matrix(settings: PlanSettings, runner: Runner) -> ExitCode:
    """Plan the jobs, print the plan, and set the outputs for the other jobs.

    Raises:
        InputError: the configuration is wrong, there is nothing to do, or the matrix is too large.
        InfrastructureError: the outputs cannot be written.
    """
    plan = plan_of(settings, event_of(os.environ))
    outputs = plan_outputs(plan)
    with stop_commands(runner):  # names of systems are untrusted
        for job, runs in plan.jobs.items():
            runner.log(f"{job}: {'yes' if runs else 'no'}")
        runner.log(f"promote: {', '.join(plan.promote) or 'no'}")
        for cell in plan.cells:
            starts = len(cell.starts(plan.seeds))
            runner.log(f"  {cell.name}{'' if starts == 1 else f': {starts} starts in one job'}")
    if settings.plan_file is not None:
        write_atomically(settings.plan_file, plan_text(plan))
    set_outputs(runner, outputs)
    return ExitCode.PASS


def plan_of(settings: PlanSettings, event: Event) -> WorkflowPlan:
    """Return the plan; changes of strangers push no image.

    Raises:
        InputError: the configuration is wrong, there is nothing to do, or the matrix is too large.
    """
    if settings.config is not None and settings.datasets:
        raise InputError("config and datasets exclude each other: a calibration.yml, or the datasets themselves")
    configuration = _read_configuration(settings)
    inputs = JobInputs(
        settings.jobs,
        settings.noise_inside_cells,
        image=bool(settings.image),
        command=bool(settings.command),
        tests=bool(settings.tests),
        analyse=settings.analyse,
        push=event.by_stranger is None,
        promote=settings.promote,
        minute_rate=settings.minute_rate,
    )
    systems = configuration.only(settings.systems) if configuration else ()
    noise = settings.noise.grid(configuration.noise if configuration else None)
    return plan_jobs(configuration, systems, noise, inputs, by_path=bool(settings.datasets))


def _read_configuration(settings: PlanSettings) -> PipelineConfiguration | None:
    if settings.datasets:
        return datasets_as_configuration(settings.datasets)
    of_code = {"unit-tests": bool(settings.tests), "static-analysis": settings.analyse}
    only_code = set(settings.jobs) <= set(of_code) if settings.jobs else any(of_code.values())
    if settings.config is None and only_code and not DEFAULT_FILE.exists():
        return None
    return read_configuration(settings.config or DEFAULT_FILE)
