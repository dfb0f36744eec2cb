"""``gather-results``: merge the results of a workflow's jobs into one table and one verdict, in its last job."""

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from calibration.base.errors import ExitCode
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import DEFAULT_ARTIFACT_NAME, artifact_name, path, text
from calibration.pipeline.distribution.gathering import gather, report_of_run
from calibration.pipeline.distribution.jobs import JOB_SUCCESS, cost_of_run, parse_needs, parse_seconds
from calibration.pipeline.distribution.plan import name_folders_by_slug, read_plan
from calibration.pipeline.page.run_page import report_page
from calibration.pipeline.results import PAGE_FILE, clear_results

COMMAND_NAME = "gather-results"


@dataclass(frozen=True)
class GatherSettings:
    """Inputs of ``gather-results``."""

    needs: str
    folder: Path
    plan_sha256: str = ""
    artifact_name: str = DEFAULT_ARTIFACT_NAME
    output: Path = Path("output")
    began: str | None = None
    """A text, because an invalid time must not fail the command."""


@click.command(COMMAND_NAME)
@click.option("--needs", required=True, help="Result, seconds and error of every job, as JSON.")
@click.option(
    "--folder", type=path, required=True, help="Folder with the artifacts of the jobs, each in a folder of its name."
)
@click.option("--plan-sha256", type=text, default="", help="Hash of the plan's file, an output of plan-matrix.")
@click.option(
    "--artifact-name", type=artifact_name, default=DEFAULT_ARTIFACT_NAME, help="Prefix of the artifact names."
)
@click.option("--output", type=path, default=Path("output"), help="Folder for the results of all (output).")
@click.option("--began", type=text, help="Start time of this job, in seconds since 1970: date +%s.")
def command(**options: Any) -> ExitCode:
    """Merge the results of a plan's jobs; the verdict is fail if one failed, or has no results."""
    return gather_results(GatherSettings(**options), Runner.from_environment())


def gather_results(settings: GatherSettings, runner: Runner) -> ExitCode:
    """Merge the results, write and report them.

    Raises:
        InputError: the results do not match the plan.
        InfrastructureError: a result cannot be written.
    """
    clear_results(settings.output)
    needs = parse_needs(settings.needs)
    name_folders_by_slug(settings.folder, settings.artifact_name)
    planned = needs.results["plan"] == JOB_SUCCESS
    plan = read_plan(settings.folder, settings.plan_sha256) if planned else None
    gathered = gather(needs, plan, settings.folder)
    code = gathered.exit_code
    promotes = bool(gathered.plan.promote) and code == ExitCode.PASS
    cost = cost_of_run(gathered.plan, needs, settings.folder, _seconds_since(settings.began), promotes=promotes)
    found = report_of_run(gathered, cost, settings.output, COMMAND_NAME)
    files = {**found.files, PAGE_FILE: report_page(found, gathered.results, settings.folder)}
    outputs = {**found.outputs, "report": settings.output / PAGE_FILE}
    publish(replace(found, files=files, outputs=outputs), runner, settings.output)
    return code


def _seconds_since(began: str | None) -> int | None:
    """Return the seconds since a time in the form of ``date +%s``; None if it is invalid or in the future."""
    if began is None or not re.fullmatch("[0-9]{1,12}", began):
        return None
    return parse_seconds(str(int(time.time()) - int(began)))
