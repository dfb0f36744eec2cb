"""``import-data``: convert recorded images and poses to a dataset."""

from pathlib import Path
from typing import Annotated, Any

import click

from calibration.base import ExitCode
from calibration.base.records import at_least, field, record
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import progress
from calibration.commands.parameters import chosen, record_options
from calibration.robot.importing.bags.recordings import SeenImages
from calibration.robot.importing.image_views import LabelledMoment
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.results import IMPORT_TITLE, import_report


@record(kw_only=True)
class ImportSettings:
    """Inputs of ``import-data``."""

    recordings: Path = field(
        "Description of the recordings and of the system to calibrate: import.yml.", formerly="config"
    )
    output: Path = field("Folder for the dataset.")
    overwrite: bool = field("Replace a dataset that the folder has.", default=False)
    parallel: Annotated[int, at_least(1)] | None = field("Processes (one a core).", default=None, formerly="jobs")


@click.command("import-data")
@record_options(ImportSettings, required=True)
def command(**options: Any) -> ExitCode:
    """Make a dataset of recordings: pair the images, detect the patterns in them, read poses and intrinsics."""
    settings = chosen(ImportSettings, options)
    runner = Runner.from_environment()

    def done(count: int, total: int, part: LabelledMoment | SeenImages) -> None:
        if isinstance(part, SeenImages):
            seen = sum(image.view.labelled for image in part.images)
            advance(count, total, f"{seen} of {len(part.images)} images show a pattern")
            return
        found = [f"{name} {sum(len(f.ids) for f in view.found.values())}" for name, view in part.views.items()]
        advance(count, total, f"corners: {', '.join(found)}")

    with progress(runner, IMPORT_TITLE, kept="parts") as advance:
        results = import_data(settings.recordings, settings.output, settings.overwrite, settings.parallel, done)
    return publish(import_report(results, settings.output), runner, settings.output)
