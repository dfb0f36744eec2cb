"""``import-data``: convert recorded images and poses to a dataset."""

import os
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.commands.record_options import chosen, record_options
from calibration.errors import ExitCode
from calibration.importing.image_views import LabelledMoment
from calibration.importing.importing import import_data
from calibration.importing.recordings import SeenImages
from calibration.importing.report import TITLE, report
from calibration.records import at_least, field, record
from calibration.report import publish
from calibration.workflow import Runner
from calibration.workflow.progress import progress


@record(kw_only=True)
class ImportSettings:
    """Inputs of ``import-data``."""

    config: Path = field("Description of the recordings and of the system to calibrate: import.yml.")
    output: Path = field("Folder for the dataset.")
    overwrite: bool = field("Replace a dataset that the folder has.", default=False)
    jobs: Annotated[int, at_least(1)] | None = field("Processes (one a core).", default=None)


@click.command("import-data")
@record_options(ImportSettings, required=True)
def command(**options: Any) -> ExitCode:
    """Make a dataset of recordings: pair the images, detect the patterns in them, read poses and intrinsics."""
    settings = chosen(ImportSettings, options)
    runner = Runner.from_environment(os.environ)

    def done(count: int, total: int, part: LabelledMoment | SeenImages) -> None:
        if isinstance(part, SeenImages):
            seen = sum(image.view.labelled for image in part.images)
            advance(count, total, f"{seen} of {len(part.images)} images show a pattern")
            return
        found = [f"{name} {sum(len(f.ids) for f in view.found.values())}" for name, view in part.views.items()]
        advance(count, total, f"corners: {', '.join(found)}")

    with progress(runner, TITLE, kept="parts") as advance:
        results = import_data(settings.config, settings.output, settings.overwrite, settings.jobs, done)
    found = report(results, settings.output)
    publish(found, runner, settings.output)
    return found.exit_code
