"""``add-collections``: add what was recorded later to a dataset, such as the poses that were advised."""

from pathlib import Path

import click

from calibration.base import ExitCode
from calibration.ci.report import Report, count_of, publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import path
from calibration.robot.importing.amending import add_collections


@click.command("add-collections")
@click.argument("recording", type=path)
@click.option("--to", type=path, required=True, help="Folder of the dataset that receives them.")
def command(recording: Path, to: Path) -> ExitCode:
    """Add the collections of a dataset of the same robot to another one: of poses that were advised, or forgotten."""
    before, added = add_collections(recording, to)
    found = Report(
        title="add-collections",
        verdict="pass",
        sentence=f"{to}: {count_of(before, 'collection')}, {added} more of {recording}",
        results={"collections": before + added, "added": added},
    )
    publish(found, Runner.from_environment())
    return ExitCode.PASS
