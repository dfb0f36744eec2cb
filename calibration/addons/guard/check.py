"""``check``: whether a sensor has moved since its calibration was accepted, by an ordinary recording."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.addons.guard.guarded import check_systems, guarded_systems
from calibration.addons.guard.lerobot.dataset_check import card_table, check_folder
from calibration.addons.guard.lerobot.episodes import is_dataset
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.results import TITLE, CheckedRecording, report
from calibration.base import ExitCode, InputError, write_atomically
from calibration.base.records import above, field, record
from calibration.ci.report import FILES, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options
from calibration.engine.baseline.quality import BASELINE_FILE
from calibration.pipeline.system import Undecided


@record(kw_only=True)
class CheckSettings:
    """Inputs of ``check``."""

    recording: tuple[str, ...] = field(
        "Bags (.bag, .db3, .mcap, a folder), videos, or folders of images; SENSOR=PATH where it is one sensor's.",
        default=(),
    )
    baseline: Path = field(
        f"File with the accepted calibrations, and the reference beside it ({BASELINE_FILE}).",
        default=Path(BASELINE_FILE),
    )
    systems: tuple[str, ...] = field("Only these systems (all).", default=())
    rate: Annotated[float, above(0, 1000)] = field(
        "Images a second of folders of images, which have no times (1).", default=1.0
    )
    undecided: Undecided = field(
        "What a sensor counts as of which the recording cannot tell: fail (exit code 1) or pass (fail).", default="fail"
    )
    card: Path | None = field(
        "File for a table in Markdown, for the card of a dataset of LeRobot or DROID.", default=None
    )
    annotate: bool = field(
        "Whether meta/calibration.json of a dataset is written: its accepted cameras, and what was found.",
        default=False,
    )
    output: Path | None = field("Folder for results.json, junit.xml and summary.md.", default=None)


def check(settings: CheckSettings, runner: Runner) -> ExitCode:
    """Check a recording, and report.

    Raises:
        InputError: the baseline, the reference or the recording is wrong.
        InfrastructureError: a library is not installed, or a result cannot be written.
    """
    if settings.output is not None:
        remove_results(settings.output, FILES)
    results = CheckedRecording(recording=settings.recording, systems=_checked(settings))
    if settings.card is not None:
        write_atomically(settings.card, card_table(results.systems))
    found = report(results, settings.undecided, settings.baseline)
    publish(found, runner, settings.output)
    return found.exit_code


def _checked(settings: CheckSettings) -> Mapping[str, tuple[SensorCheck, ...]]:
    """Return what is said of the sensors of each system, or of each episode of a dataset."""
    datasets = [path for each in settings.recording if is_dataset(path := Path(each))]
    if datasets:
        if len(settings.recording) > 1:
            raise InputError(f"{datasets[0]}: found a dataset among other recordings, expected it alone")
        return check_folder(datasets[0], settings.baseline, settings.annotate)
    if settings.card is not None or settings.annotate:
        raise InputError("found 'card' or 'annotate', expected the folder of a dataset, with meta/info.json")
    guarded = guarded_systems(settings.baseline, settings.recording, settings.systems, settings.rate)
    return check_systems(guarded, settings.baseline)


@click.command(TITLE)
@click.argument("recordings", nargs=-1)
@record_options(CheckSettings)
def command(recordings: tuple[str, ...], **options: Any) -> ExitCode:
    """Check by RECORDINGS whether a sensor has moved since its calibration was accepted; exit code 1 if one has.

    No board is needed, and nothing is calibrated. Of fixed cameras the still scene is compared with the reference that
    accept --reference keeps.
    """
    options["recording"] = (*recordings, *(options.get("recording") or ()))
    return check(chosen(CheckSettings, options), Runner.from_environment(os.environ))
