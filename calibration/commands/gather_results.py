"""``gather-results``: what the jobs of a workflow found, as one table and one verdict; its last job runs this."""

import os
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from calibration.commands.parameters import path, text
from calibration.errors import ExitCode
from calibration.pipeline.distribution.cost import cost_of_run
from calibration.pipeline.distribution.gathering import gather, report_of_run
from calibration.pipeline.distribution.jobs import parse_needs, parse_seconds
from calibration.pipeline.page.whole import report_page
from calibration.pipeline.results import PAGE_FILE, clear_results
from calibration.report import publish
from calibration.workflow import Runner

TITLE = "gather-results"


@dataclass(frozen=True)
class Settings:
    """What ``gather-results`` is asked."""

    needs: str
    folder: Path
    output: Path = Path("output")
    began: str | None = None
    """A text, since a time that is none is no reason to be red."""


@click.command(TITLE)
@click.option("--needs", required=True, help="What became of the jobs: ${{ toJSON(needs) }}.")
@click.option("--folder", type=path, required=True, help="What the jobs left, each in a folder with its slug.")
@click.option("--output", type=path, default=Path("output"), help="Folder for the results of all (output).")
@click.option("--began", type=text, help="When the job that gathers began, in seconds since 1970: date +%s.")
def command(**options: Any) -> ExitCode:
    """Gather what the jobs of a plan found; the verdict is fail when one failed, or left nothing."""
    return gather_results(Settings(**options), Runner.from_environment(os.environ))


def gather_results(settings: Settings, runner: Runner) -> ExitCode:
    """Gather, write the results of all, and report them.

    Raises:
        InputError: the jobs left something else than what was planned.
        InfrastructureError: a result cannot be written.
    """
    clear_results(settings.output)
    needs = parse_needs(settings.needs)
    gathered = gather(needs, settings.folder)
    code = gathered.exit_code
    promotes = bool(gathered.plan.promote) and code == ExitCode.PASS
    cost = cost_of_run(gathered.plan, needs, settings.folder, _seconds_since(settings.began), promotes=promotes)
    found = report_of_run(gathered, cost, settings.output, TITLE)
    files = {**found.files, PAGE_FILE: report_page(found, gathered.results, settings.folder)}
    outputs = {**found.outputs, "report": settings.output / PAGE_FILE}
    publish(replace(found, files=files, outputs=outputs), runner, settings.output)
    return code


def _seconds_since(began: str | None) -> int | None:
    """Seconds from a time as ``date +%s`` tells it until now; None where it is none, or lies ahead."""
    if began is None or not re.fullmatch("[0-9]{1,12}", began):
        return None
    return parse_seconds(str(int(time.time()) - int(began)))
