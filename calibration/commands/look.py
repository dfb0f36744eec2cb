"""``look``: what is in a recording, and what it lacks for a calibration."""

from pathlib import Path

import click

from calibration.base import ExitCode
from calibration.ci.report import FILES, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.commands.parameters import path
from calibration.robot.importing.look.looking import look
from calibration.robot.importing.results import look_report


@click.command("look")
@click.argument("recording", type=path)
@click.option("--pattern", type=path, help="import.yml that describes the pattern (the one found in the images).")
@click.option("--output", type=path, help="Folder for results.json, junit.xml and summary.md.")
def command(recording: Path, pattern: Path | None, output: Path | None) -> ExitCode:
    """Look at a recording before it is imported: a bag, a folder of images, a video, or an import.yml.

    Exit code 1 if something is missing for a calibration.
    """
    remove_results(output, FILES)
    return publish(look_report(look(recording, pattern), output), Runner.from_environment(), output)
