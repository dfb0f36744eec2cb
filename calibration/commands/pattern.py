"""``pattern``: write a board to print, and the lines of import.yml that describe it."""

import sys
from pathlib import Path
from typing import Any, get_args

import click

from calibration.base import ExitCode, write_atomically
from calibration.base.records import read
from calibration.commands.parameters import count, number, path
from calibration.engine.dataset.pattern import CIRCLE_KINDS, PatternKind
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.printed_sheet import PAPER_SIZES_MM, board_sheet, pdf, svg
from calibration.robot.labelling.corner_detector import corner_detector

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
def command(kind: PatternKind, paper: str, output: Path, **given: Any) -> ExitCode:
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
