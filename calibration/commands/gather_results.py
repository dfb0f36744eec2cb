"""``gather-results``: what the jobs of a workflow found, as one table and one verdict; its last job runs this."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from calibration.commands.parameters import path
from calibration.errors import ExitCode
from calibration.workflow import Annotation, Runner, add_summary, annotate, set_outputs

TITLE = "gather-results"


@dataclass(frozen=True)
class Settings:
    """What ``gather-results`` is asked."""

    needs: str
    folder: Path
    output: Path = Path("output")


@click.command(TITLE)
@click.option("--needs", required=True, help="What became of the jobs: ${{ toJSON(needs) }}.")
@click.option("--folder", type=path, required=True, help="What the jobs left, each in a folder with its slug.")
@click.option("--output", type=path, default=Path("output"), help="Folder for the results of all (output).")
def command(**options: Any) -> ExitCode:
    """Gather what the jobs of a plan found; the verdict is fail when one failed, or left nothing."""
    return gather_results(Settings(**options), Runner.from_environment(os.environ))


def gather_results(settings: Settings, runner: Runner) -> ExitCode:
    """Gather, write the results of all, and report them.

    Raises:
        InputError: the jobs left something else than what was planned.
        WorldError: a result cannot be written.
    """
    from calibration.pipeline.distribution.gathering import gather
    from calibration.pipeline.distribution.needs import parse_needs
    from calibration.pipeline.report import report
    from calibration.pipeline.results import clear_results, write_results
    from calibration.workflow.summary import markdown_table

    clear_results(settings.output)
    gathered = gather(parse_needs(settings.needs), settings.folder)
    annotate(runner, [Annotation(line, title=TITLE) for line in gathered.problems])
    if gathered.results.judged:
        write_results(gathered.results, settings.output)
        report(gathered.results, settings.output, runner, TITLE)
    add_summary(runner, "\n" + markdown_table(("Job", "Result"), gathered.jobs.items()))
    code = gathered.exit_code
    verdict = "pass" if code == ExitCode.PASS else "fail"
    set_outputs(runner, {"verdict": verdict})  # of the jobs too, not of the results alone
    runner.log(f"{verdict}: {', '.join(f'{job} {result}' for job, result in gathered.jobs.items())}")
    return code
