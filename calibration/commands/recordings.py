"""Commands of recordings: ``look``, ``watch``, ``import-data``, ``label``, ``add-collections``; and ``pattern``."""

import sys
from pathlib import Path
from typing import Annotated, Any, get_args

import click

from calibration.base import ExitCode, temporary_folder, write_atomically
from calibration.base.records import at_least, field, read, record
from calibration.ci.report import FILES, Report, count_of, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import progress
from calibration.commands.parameters import (
    ActionInput,
    boolean_option,
    chosen,
    count,
    given,
    non_negative,
    number,
    path,
    record_options,
)
from calibration.engine.dataset.pattern import CIRCLE_KINDS, PatternKind
from calibration.engine.diagnosis.limits import Limits
from calibration.pipeline.watching import WatchedRecording, watch
from calibration.robot.importing.amending import add_collections, label_dataset
from calibration.robot.importing.bags.recordings import SeenImages
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import LabelledMoment
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.look.looking import look
from calibration.robot.importing.printed_sheet import PAPER_SIZES_MM, board_sheet, pdf, svg
from calibration.robot.importing.results import IMPORT_TITLE, import_report, label_report, look_report
from calibration.robot.labelling.corner_detector import corner_detector


@click.command("look")
@click.argument("recording", type=path)
@click.option("--pattern", type=path, help="import.yml that describes the pattern (the one found in the images).")
@click.option("--output", type=path, help="Folder for results.json, junit.xml and summary.md.")
def look_command(recording: Path, pattern: Path | None, output: Path | None) -> ExitCode:
    """Look at a recording before it is imported: a bag, a folder of images, a video, or an import.yml.

    Exit code 1 if something is missing for a calibration.
    """
    remove_results(output, FILES)
    return publish(look_report(look(recording, pattern), output), Runner.from_environment(), output)


OF_LIMITS = ("translation-mm", "rotation-deg", "projection-px", "guard-band")


@click.command("watch")
@click.argument("recording", type=path)
@record_options(Limits, *OF_LIMITS)
@click.option("--output", type=path, help="Folder for the dataset of the used views, written at the end.")
@boolean_option("--overwrite", help="Replace a dataset that the folder has.")
@click.option("--idle", type=non_negative, help="End after so many seconds without a new image, too (Ctrl-C).")
def watch_command(
    recording: Path, output: Path | None, overwrite: bool, idle: float | None, **options: Any
) -> ExitCode:
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
def import_data_command(**options: Any) -> ExitCode:
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


@click.command("add-collections")
@click.argument("recording", type=path)
@click.option("--to", type=path, required=True, help="Folder of the dataset that receives them.")
def add_collections_command(recording: Path, to: Path) -> ExitCode:
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


@click.command("label")
@click.option("--dataset", type=path, required=True, help="Dataset with images: its folder.")
@click.option("--output", type=path, required=True, help="Folder for the labelled dataset.")
@boolean_option("--again", help="Label images again that already have labels.")
@boolean_option("--overwrite", help="Replace a dataset that the output has.")
@click.option(*("--parallel", "--jobs"), cls=ActionInput, formerly="jobs", type=count, help="Processes (one a core).")
def label_command(dataset: Path, output: Path, again: bool, overwrite: bool, parallel: int | None) -> ExitCode:
    """Detect the patterns in the images of a dataset's cameras; labels of other sensors are kept."""
    runner = Runner.from_environment()

    def done(number: int, total: int, moment: LabelledMoment) -> None:
        found = [f"{name} {sum(len(f.ids) for f in view.found.values())}" for name, view in moment.views.items()]
        advance(number, total, f"corners: {', '.join(found)}")

    with progress(runner, "label", kept="collections") as advance:
        results = label_dataset(dataset, output, again, overwrite, parallel, done)
    return publish(label_report(results, output), runner, output)


PATTERN_NAME = "board"
"""Name of the pattern in import.yml."""
DEFAULT_MARKER, DEFAULT_DICTIONARY, DEFAULT_SPACING, DEFAULT_DIAMETER = 0.75, "DICT_5X5_1000", 0.3, 0.6
"""What is taken without an option: a marker's side in squares, the dictionary, the gap between tags in their sides, a
circle's diameter in spacings."""


@click.command("pattern")
@click.argument("kind", type=click.Choice(get_args(PatternKind)))
@click.option(
    "--columns",
    type=count,
    help="Corners inside, along a row; of an aprilgrid tags, of circles those of a row.",
)
@click.option("--rows", type=count, help="Corners inside, along a column; of an aprilgrid tags, of circles rows.")
@click.option("--square", type=number, help="Side of a square, mm.")
@click.option("--marker", type=number, help="Side of a marker of a charuco board, mm (0.75 of the square).")
@click.option("--dictionary", help="Dictionary of a charuco board's markers, or of a tag (DICT_5X5_1000).")
@click.option("--tag", type=number, help="Side of a tag, mm.")
@click.option("--spacing", type=number, help="Gap between tags, in sides of a tag (0.3); of circles, mm.")
@click.option("--diameter", type=number, help="Diameter of circles, mm (0.6 of the spacing).")
@click.option("--first", type=int, help="Lowest id of its markers or tags (0); id of a single tag.")
@click.option("--inverted", is_flag=True, help="Exchange black and white.")
@click.option("--paper", type=click.Choice(list(PAPER_SIZES_MM)), default="A4", help="Size of the paper (A4).")
@click.option("--output", type=path, default=Path(PATTERN_NAME), help="Files without their endings (board).")
def pattern_command(kind: PatternKind, paper: str, output: Path, **given: Any) -> ExitCode:
    """Write a board as SVG and PDF, true to size, with a ruler on it, and print its lines of import.yml."""
    keys = {"type": kind} | {key: value for key, value in given.items() if value not in (None, False)}
    if kind == "charuco":
        if "square" in keys:
            keys.setdefault("marker", DEFAULT_MARKER * keys["square"])
        keys.setdefault("dictionary", DEFAULT_DICTIONARY)
    if kind == "aprilgrid":
        keys.setdefault("spacing", DEFAULT_SPACING)
    if kind in CIRCLE_KINDS and "spacing" in keys:
        keys.setdefault("diameter", DEFAULT_DIAMETER * keys["spacing"])
    lengths = ("square", "marker", "tag", "diameter", *(("spacing",) if kind in CIRCLE_KINDS else ()))
    if kind == "tags":
        keys.setdefault("dictionary", DEFAULT_DICTIONARY)
        side = {"size": round(keys.pop("tag") / 1000, 9)} if "tag" in keys else {}
        keys["tags"] = [{"id": keys.pop("first", 0), **side}]
    keys |= {key: round(keys[key] / 1000, 9) for key in lengths if key in keys}
    document = {"sensors": {"camera": {"images": "images"}}, "patterns": {PATTERN_NAME: keys}}
    (described,) = read(ImportDescription, document, "the board").patterns
    pattern = pattern_configuration(described, "world")
    corner_detector(pattern)  # refuses what cannot be printed
    sheet = board_sheet(pattern, paper)
    for ending, content in (("svg", svg(sheet).encode()), ("pdf", pdf(sheet))):
        write_atomically(output.with_name(f"{output.name}.{ending}"), content)
    values = ", ".join(f"{key}: {str(value).lower() if value is True else value}" for key, value in keys.items())
    sys.stdout.write(f"patterns:\n  {PATTERN_NAME}: {{{values}}}\n")
    return ExitCode.PASS
