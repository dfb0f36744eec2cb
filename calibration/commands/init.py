"""``init``: create calibration.yml and a workflow for a dataset."""

from collections.abc import Iterator
from pathlib import Path

import click

from calibration.base import ExitCode, InputError, one_line, write_atomically
from calibration.ci.github.service import WORKFLOW_FILE, first_workflow
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import boolean_option, path
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.first_configuration import FirstConfiguration, first_configuration

DEFAULT_SUITE = "OWNER/calibration-ci@v1"
"""`make owner OWNER=NAME` puts a name in the place of OWNER, here and wherever else it stands."""
CONFIGURATION_FILE = Path("calibration.yml")


@click.command("init")
@click.option("--dataset", type=path, required=True, help="Dataset: its folder in the repository.")
@click.option("--output", type=path, default=".", show_default=True, help="Folder of the repository.")
@click.option("--suite", default=DEFAULT_SUITE, show_default=True, help="Where the workflow comes from.")
@boolean_option("--overwrite", help="Replace files that are there.")
@boolean_option("--although", help="Write them although the recording does not pass; it will be red.")
def command(dataset: Path, output: Path, suite: str, overwrite: bool, although: bool) -> ExitCode:
    """Write a first calibration.yml for a dataset, and the workflow that runs it on every push.

    The dataset is calibrated, and judged without limits; those of a good robot are written for later runs. If it does
    not pass, nothing is written without --although.
    """
    repository, at, version = suite.partition("@")
    if not at or repository.count("/") != 1 or any(not (c.isalnum() or c in "/._-@") for c in suite):
        raise InputError(f"suite: found '{suite}', expected OWNER/REPOSITORY@VERSION")
    configuration, workflow = output / CONFIGURATION_FILE, output / WORKFLOW_FILE
    for file in (configuration, workflow):
        if file.exists() and not overwrite:
            raise InputError(f"{file}: there is such a file already: move it, or add --overwrite")
    first = first_configuration(dataset, output)
    written = although or not first.reasons
    if written:
        write_atomically(configuration, first.text)
        write_atomically(workflow, first_workflow(repository, version))
        read_configuration(configuration)
    runner = Runner.from_environment()
    with stop_commands(runner):
        for each in _messages_of_init(first, dataset, configuration, workflow, suite=suite, written=written):
            runner.log(one_line(each))
    return ExitCode.FAIL if first.reasons or first.undecided else ExitCode.PASS


def _messages_of_init(
    first: FirstConfiguration, dataset: Path, configuration: Path, workflow: Path, *, suite: str, written: bool
) -> Iterator[str]:
    """Yield the lines of the log: all that was found, what was written, what is next."""
    yield from (f"{first.name}: {each}" for each in (*first.missing, *first.found))
    yield from (f"{first.name}: undecided: {each}" for each in first.undecided)
    yield from (f"{first.name}: fails: {each}" for each in first.reasons)
    if not written:
        yield (
            f"{configuration}: not written: mend what is named and record again; --although writes it, and every run "
            f"will fail"
        )
        return
    word = "fails as it is" if first.reasons else "is undecided" if first.undecided else "passes"
    yield f"{configuration}, {workflow}: written; {first.name} {word}"
    if suite.startswith("OWNER/"):
        yield f"{workflow}: put the owner of your copy of the suite in the place of OWNER"
    if word == "passes":
        commit = f"commit these, {dataset} and calibration-baseline.json"
        yield f"next: calibration run, calibration accept; then {commit}"
