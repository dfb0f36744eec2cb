"""``watch``: images of a recording as they arrive, and what they are worth."""

from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, temporary_folder
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import boolean_option, chosen, given, non_negative, path, record_options
from calibration.engine.diagnosis.limits import Limits
from calibration.pipeline.watching import WatchedRecording, watch

OF_LIMITS = ("translation-mm", "rotation-deg", "projection-px", "guard-band")


@click.command("watch")
@click.argument("recording", type=path)
@record_options(Limits, *OF_LIMITS)
@click.option("--output", type=path, help="Folder for the dataset of the used views, written at the end.")
@boolean_option("--overwrite", help="Replace a dataset that the folder has.")
@click.option("--idle", type=non_negative, help="End after so many seconds without a new image, too (Ctrl-C).")
def command(recording: Path, output: Path | None, overwrite: bool, idle: float | None, **options: Any) -> ExitCode:
    """Watch the images of a recording arrive: an import.yml that names their folders or a bag, or a folder that has it.

    Says of each image whether it is used and why not, the error bars so far, and what to record next; also on a page,
    watch.html beside import.yml. Exit code 1 if the used views cannot be calibrated at the end.
    """
    runner = Runner.from_environment()
    limits = chosen(Limits, options) if given(Limits, options, *OF_LIMITS) else Limits()
    with temporary_folder() as folder:
        found = watch(WatchedRecording(recording, limits, folder), runner, output, overwrite, idle)
    publish(found, runner)
    return found.exit_code
