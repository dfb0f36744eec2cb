"""``gather-results``: merge the results of a workflow's jobs into one table and one verdict, in its last job."""

import re
import time
from dataclasses import replace
from pathlib import Path

import click

from calibration.base import ExitCode
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import DEFAULT_ARTIFACT_NAME, path, text
from calibration.commands.parameters import artifact_name as artifact_name_type
from calibration.pipeline.gathering import JOB_SUCCESS, cost_of_run, gather, parse_needs, parse_seconds, report_of_run
from calibration.pipeline.page.run_page import report_page
from calibration.pipeline.results import PAGE_FILE, clear_results
from calibration.pipeline.workflow_plan import name_folders_by_slug, read_plan


@click.command("gather-results")
@click.option("--needs", required=True, help="Result, seconds and error of every job, as JSON.")
@click.option(
    "--folder", type=path, required=True, help="Folder with the artifacts of the jobs, each in a folder of its name."
)
@click.option("--plan-sha256", type=text, default="", help="Hash of the plan's file, an output of plan-matrix.")
@click.option(
    "--artifact-name", type=artifact_name_type, default=DEFAULT_ARTIFACT_NAME, help="Prefix of the artifact names."
)
@click.option("--output", type=path, default=Path("output"), help="Folder for the results of all (output).")
@click.option("--began", type=text, help="Start time of this job, in seconds since 1970: date +%s.")
def command(
    needs: str, folder: Path, plan_sha256: str, artifact_name: str, output: Path, began: str | None
) -> ExitCode:
    """Merge the results of a plan's jobs; the verdict is fail if one failed, or has no results."""
    clear_results(output)
    jobs = parse_needs(needs)
    name_folders_by_slug(folder, artifact_name)
    planned = jobs.results["plan"] == JOB_SUCCESS
    plan = read_plan(folder, plan_sha256) if planned else None
    gathered = gather(jobs, plan, folder)
    code = gathered.exit_code
    promotes = bool(gathered.plan.promote) and code == ExitCode.PASS
    cost = cost_of_run(gathered.plan, jobs, folder, _seconds_since(began), promotes=promotes)
    found = report_of_run(gathered, cost, output)
    files = {**found.files, PAGE_FILE: report_page(found, gathered.results, folder)}
    outputs = {**found.outputs, "report": output / PAGE_FILE}
    publish(replace(found, files=files, outputs=outputs), Runner.from_environment(), output)
    return code


def _seconds_since(began: str | None) -> int | None:
    """Return the seconds since a time in the form of ``date +%s``; None if it is invalid or in the future."""
    if began is None or not re.fullmatch("[0-9]{1,12}", began):
        return None
    return parse_seconds(str(int(time.time()) - int(began)))
