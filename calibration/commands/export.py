"""``export``: write a calibrated dataset in the file formats of robots."""

from collections.abc import Mapping
from pathlib import Path

import click

from calibration.base import ExitCode, InputError, did_you_mean, one_line, write_atomically
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import TEXT_LIST, assignments, path, text
from calibration.engine.dataset.reading import read_dataset
from calibration.pipeline.results import cell_that_wrote, refuse_what_has_not_passed
from calibration.robot.exports import FORMATS, URDF, exported
from calibration.robot.robot_description import XacroInputs


@click.command("export")
@click.option("--dataset", type=path, required=True, help="Calibrated dataset: a cell's folder, or its dataset.json.")
@click.option(
    "--robot-description", type=path, help="The robot's URDF or xacro, to be written as URDF with calibrated origins."
)
@click.option("--xacro", type=assignments, help="Arguments of the xacro: ur_type=ur5e, name=left.")
@click.option("--packages", type=path, help="Folder with the packages that the xacro includes.")
@click.option("--formats", type=TEXT_LIST, help=f"{URDF}, {', '.join(FORMATS)} (all that there can be).")
@click.option("--although", type=text, help="Why a calibration that has not passed is exported all the same.")
@click.option("--output", type=path, default="exports", show_default=True, help="Folder to write.")
def command(
    dataset: Path,
    robot_description: Path | None,
    xacro: Mapping[str, str] | None,
    packages: Path | None,
    formats: tuple[str, ...] | None,
    although: str | None,
    output: Path,
) -> ExitCode:
    """Write a calibration as URDF, launch files, camera_info, Kalibr's camchain and OpenCV's storage.

    In the URDF only calibrated origins are changed; every other byte of the robot's file, or of the expanded xacro, is
    kept.
    """
    known = (URDF, *FORMATS)
    for each in formats or ():
        if each not in known:
            raise InputError(f"--formats: found '{each}', expected {', '.join(known)}{did_you_mean(each, known)}")
    read = read_dataset(dataset)
    cell = cell_that_wrote(dataset)
    if not although:
        refuse_what_has_not_passed(dataset, read, cell)
    files, notes = exported(read, formats or (), robot_description, XacroInputs(xacro or {}, packages))
    notes += [each.text for each in cell.findings if each.kind == "after-move"] if cell else []
    if cell is not None and cell.verdict == "undecided" and not although:
        notes.append(f"undecided, which passes here (undecided: pass): {cell.undecided[0]}")
    for name, content in files.items():
        write_atomically(output / name, content)
    runner = Runner.from_environment()
    with stop_commands(runner):
        for line in (*(f"{output / name}" for name in files), *notes):
            runner.log(one_line(line))
    return ExitCode.PASS
