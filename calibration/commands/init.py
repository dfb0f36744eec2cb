"""``init``: create calibration.yml and a workflow for a dataset."""

import os
from pathlib import Path

import click

from calibration.commands.parameters import boolean_option, path
from calibration.errors import ExitCode, InputError
from calibration.files import write_atomically
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.first_configuration import first_configuration
from calibration.workflow import Runner, stop_commands
from calibration.workflow.text import one_line

SUITE = "OWNER/calibration-ci@v1"
CONFIGURATION, WORKFLOW = Path("calibration.yml"), Path(".github", "workflows", "calibration.yml")
_WORKFLOW = """# Written by `calibration init`: calibrates what calibration.yml names, on every push and pull request.
name: Calibration
on:
  push: {{branches: [main]}}
  pull_request:
permissions: {{}}
jobs:
  robot:
    uses: {suite}/.github/workflows/pipeline.yml@{version}
    permissions: {{contents: read, pull-requests: write}}
    with:
      comment: keep   # one comment on the pull request, written anew by every run; a fork's has the summary alone
"""


@click.command("init")
@click.option("--dataset", type=path, required=True, help="Dataset: its folder in the repository.")
@click.option("--output", type=path, default=".", show_default=True, help="Folder of the repository.")
@click.option("--suite", default=SUITE, show_default=True, help="Where the workflow comes from.")
@boolean_option("--overwrite", help="Replace files that are there.")
def command(dataset: Path, output: Path, suite: str, overwrite: bool) -> ExitCode:
    """Write a first calibration.yml for a dataset, and the workflow that runs it on every push."""
    return init(dataset, output, suite, Runner.from_environment(os.environ), overwrite=overwrite)


def init(dataset: Path, output: Path, suite: str, runner: Runner, *, overwrite: bool = False) -> ExitCode:
    """Calibrate a dataset, and write its limits for later runs.

    Returns:
        FAIL if the dataset does not pass the new configuration; the log has the reasons.

    Raises:
        InputError: a file exists, or the dataset is wrong or cannot be calibrated.
        InfrastructureError: a file cannot be written.
    """
    repository, at, version = suite.partition("@")
    if not at or repository.count("/") != 1 or any(not (c.isalnum() or c in "/._-@") for c in suite):
        raise InputError(f"suite: found '{suite}', expected OWNER/REPOSITORY@VERSION")
    configuration, workflow = output / CONFIGURATION, output / WORKFLOW
    for file in (configuration, workflow):
        if file.exists() and not overwrite:
            raise InputError(f"{file}: there is such a file already: move it, or add --overwrite")
    first = first_configuration(dataset, output)
    write_atomically(configuration, first.text)
    write_atomically(workflow, _WORKFLOW.format(suite=repository, version=version))
    read_configuration(configuration)
    with stop_commands(runner):
        for each in (*first.missing, *first.reasons):
            runner.log(one_line(f"{first.name}: {each}"))
        word = "fails as it is" if first.reasons else "passes"
        runner.log(one_line(f"{configuration}, {workflow}: written; {first.name} {word}"))
        if suite == SUITE:
            runner.log(one_line(f"{workflow}: put the owner of your copy of the suite in the place of OWNER"))
        if not first.reasons:
            commit = f"commit these, {dataset} and calibration-baseline.json"
            runner.log(one_line(f"next: calibration run, calibration accept; then {commit}"))
    return ExitCode.FAIL if first.reasons else ExitCode.PASS
