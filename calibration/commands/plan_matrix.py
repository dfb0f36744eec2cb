"""``plan-matrix``: plan the jobs of the reusable workflow, in its first job."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, InputError, write_atomically
from calibration.base.records import read
from calibration.ci.services import event_of
from calibration.ci.workflow import Runner, set_outputs, stop_commands
from calibration.commands.parameters import (
    NOISE_OPTION_OF_KEY,
    PATH_LIST,
    TEXT_LIST,
    ActionInput,
    artifact_name,
    boolean_option,
    chosen,
    given,
    path,
    record_options,
)
from calibration.pipeline.configuration import DEFAULT_FILE, PipelineConfiguration, read_configuration
from calibration.pipeline.system import Noise, System
from calibration.pipeline.workflow_plan import (
    JobInputs,
    datasets_as_configuration,
    plan_jobs,
    plan_outputs,
    plan_text,
)


def _inputs_of_other_jobs(command: Callable[..., ExitCode]) -> Callable[..., ExitCode]:
    """Declare deprecated inputs of the workflow that other jobs use: the first job tells that they are."""
    told: dict[str, tuple[str, str | None]] = {"rules": ("systems.NAME.rules", "what the file has")}
    told |= {f"analysis-{key}": (f"analysis.{key}", None) for key in ("max-new", "max-total", "max-file")}
    for name, (key, written) in told.items():
        used_later: dict[str, Any] = {"cls": ActionInput, "instead": key, "written": written, "type": TEXT_LIST}
        command = click.option(f"--{name}", **used_later, help="Used by a later job.")(command)
    return command


@click.command("plan-matrix")
@click.option("--config", type=path, help="The configuration (calibration.yml).")
@click.option(
    "--datasets",
    cls=ActionInput,
    instead="systems.NAME.dataset",
    written="the folder",
    type=PATH_LIST,
    help="Datasets, each a system; instead of config.",
)
@click.option("--systems", type=TEXT_LIST, help="Only these systems.")
@record_options(
    Noise,
    *("translation", "rotation", "seeds"),
    names=NOISE_OPTION_OF_KEY,
    helps={"seeds": "How many seeds for each pair of noises (1); always inside a job."},
)
@record_options(Noise, "seed-list", instead="noise")
@record_options(System, "evaluate", instead="systems.NAME")
@record_options(JobInputs, "noise-inside-cells", "image")
@record_options(JobInputs, "command", instead="systems.NAME.software")
@record_options(JobInputs, "tests")
@boolean_option(
    "--analyse",
    cls=ActionInput,
    instead="analysis",
    written={},
    help="Analyse the code of the repository (no).",
)
@_inputs_of_other_jobs
@record_options(JobInputs, "jobs", "may-promote", "minute-rate")
@click.option("--artifact-name", type=artifact_name, help="Prefix of the artifact names (calibration).")
@click.option("--plan-file", type=path, help="File for the plan, which gather-results reads.")
def command(
    config: Path | None,
    datasets: tuple[Path, ...] | None,
    systems: tuple[str, ...] | None,
    plan_file: Path | None,
    **options: Any,
) -> ExitCode:
    """Plan the jobs of a workflow: one for each system and pair of noises, as the matrix of a GitHub job.

    Changes of strangers push no image.
    """
    runner = Runner.from_environment()
    inputs = chosen(JobInputs, options, push=event_of(os.environ).by_stranger is None)
    noise = read(Noise, given(Noise, options, names=NOISE_OPTION_OF_KEY), "options")
    if config is not None and datasets:
        raise InputError("config and datasets exclude each other: a calibration.yml, or the datasets themselves")
    configuration = datasets_as_configuration(datasets) if datasets else _read_configuration(config, inputs)
    chosen_systems = configuration.only(systems or ()) if configuration else ()
    grid = noise.grid(configuration.noise if configuration else None)
    plan = plan_jobs(configuration, chosen_systems, grid, inputs, by_path=bool(datasets))
    outputs = plan_outputs(plan)
    with stop_commands(runner):  # names of systems are untrusted
        for job, runs in plan.jobs.items():
            runner.log(f"{job}: {'yes' if runs else 'no'}")
        runner.log(f"promote: {', '.join(plan.promote) or 'no'}")
        for cell in plan.cells:
            starts = len(cell.starts(plan.seeds))
            runner.log(f"  {cell.name}{'' if starts == 1 else f': {starts} starts in one job'}")
    if plan_file is not None:
        write_atomically(plan_file, plan_text(plan))
    set_outputs(runner, outputs)
    return ExitCode.PASS


def _read_configuration(config: Path | None, inputs: JobInputs) -> PipelineConfiguration | None:
    """Return the configuration; None if only code is tested and analysed, and there is no file."""
    of_code = {"unit-tests": bool(inputs.tests), "static-analysis": inputs.analyse}
    only_code = set(inputs.jobs) <= set(of_code) if inputs.jobs else any(of_code.values())
    if config is None and only_code and not DEFAULT_FILE.exists():
        return None
    return read_configuration(config or DEFAULT_FILE)
