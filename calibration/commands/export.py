"""``export``: a calibrated dataset in the forms that a robot takes."""

import os
from pathlib import Path

import click

from calibration.commands.parameters import TEXT_LIST, path
from calibration.dataset.reading import read_dataset
from calibration.errors import ExitCode, InputError
from calibration.exports.calibrated import Calibrated, calibrated
from calibration.exports.formats import FORMATS, URDF
from calibration.exports.urdf import calibrated_urdf
from calibration.files import read_bytes, write_atomically
from calibration.workflow import Runner, stop_commands
from calibration.workflow.text import did_you_mean, one_line

LARGEST_URDF = 50_000_000
CALIBRATED_URDF = "calibrated.urdf"


@click.command("export")
@click.option("--dataset", type=path, required=True, help="Calibrated dataset: a cell's folder, or its dataset.json.")
@click.option("--robot-description", type=path, help="The robot's URDF, to be written with calibrated origins.")
@click.option("--formats", type=TEXT_LIST, help=f"{URDF}, {', '.join(FORMATS)} (all that there can be).")
@click.option("--output", type=path, default="exports", show_default=True, help="Folder to write.")
def command(dataset: Path, robot_description: Path | None, formats: tuple[str, ...] | None, output: Path) -> ExitCode:
    """Write a calibration as URDF, launch files, camera_info, Kalibr's camchain and OpenCV's storage.

    The URDF is the robot's own file: only calibrated origins change in it, every other byte stays.
    """
    return export(dataset, robot_description, formats or (), output, Runner.from_environment(os.environ))


def export(dataset: Path, description: Path | None, formats: tuple[str, ...], output: Path, runner: Runner) -> ExitCode:
    """Write the files of the formats.

    Args:
        dataset: the calibrated one.
        description: the robot's URDF; None for none.
        formats: their names; none for all, but those that these data cannot have.
        output: the folder.
        runner: where lines go.

    Raises:
        InputError: an unknown format, a dataset that is not calibrated, a URDF that does not fit it.
        WorldError: a file cannot be written.
    """
    known = (URDF, *FORMATS)
    for each in formats:
        if each not in known:
            raise InputError(f"--formats: found '{each}', expected {', '.join(known)}{did_you_mean(each, known)}")
    if URDF in formats and description is None:
        raise InputError("--formats: 'urdf' needs the robot's own file: add --robot-description robot.urdf")
    of = calibrated(read_dataset(dataset))
    files, notes = _texts(of, formats)
    if description is not None and (URDF in formats or not formats):
        made = calibrated_urdf(
            read_bytes(description, LARGEST_URDF, "a URDF"), {**of.transforms, **of.joints}, str(description)
        )
        files = {CALIBRATED_URDF: made.content} | files
        notes = [*made.notes, *notes]
    for name, content in files.items():
        write_atomically(output / name, content)
    with stop_commands(runner):
        for line in (*(f"{output / name}" for name in files), *notes):
            runner.log(one_line(line))
    return ExitCode.PASS


def _texts(of: Calibrated, formats: tuple[str, ...]) -> tuple[dict[str, bytes], list[str]]:
    """The files of formats by their names, and which formats these data cannot have where all are asked for."""
    files: dict[str, bytes] = {}
    notes = []
    for name, each in FORMATS.items():
        if formats and name not in formats:
            continue
        try:
            files |= {file: text.encode() for file, text in each.files(of).items()}
        except InputError as error:
            if formats:
                raise
            notes.append(f"no {name}: {error}")
    return files, notes
