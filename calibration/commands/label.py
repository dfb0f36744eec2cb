"""``label``: label the images of a dataset with our detectors."""

from pathlib import Path

import click

from calibration.base import ExitCode
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import progress
from calibration.commands.parameters import ActionInput, boolean_option, count, path
from calibration.robot.importing.amending import label_dataset
from calibration.robot.importing.image_views import LabelledMoment
from calibration.robot.importing.results import label_report


@click.command("label")
@click.option("--dataset", type=path, required=True, help="Dataset with images: its folder.")
@click.option("--output", type=path, required=True, help="Folder for the labelled dataset.")
@boolean_option("--again", help="Label images again that already have labels.")
@boolean_option("--overwrite", help="Replace a dataset that the output has.")
@click.option(*("--parallel", "--jobs"), cls=ActionInput, formerly="jobs", type=count, help="Processes (one a core).")
def command(dataset: Path, output: Path, again: bool, overwrite: bool, parallel: int | None) -> ExitCode:
    """Detect the patterns in the images of a dataset's cameras; labels of other sensors are kept."""
    runner = Runner.from_environment()

    def done(number: int, total: int, moment: LabelledMoment) -> None:
        found = [f"{name} {sum(len(f.ids) for f in view.found.values())}" for name, view in moment.views.items()]
        advance(number, total, f"corners: {', '.join(found)}")

    with progress(runner, "label", kept="collections") as advance:
        results = label_dataset(dataset, output, again, overwrite, parallel, done)
    return publish(label_report(results, output), runner, output)
