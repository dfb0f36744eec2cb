"""Export of a calibrated dataset to all files of the requested formats."""

from collections.abc import Sequence
from pathlib import Path

from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset
from calibration.robot.exports.calibrated import Calibrated, calibrated
from calibration.robot.exports.formats import FILES
from calibration.robot.exports.names import FORMATS, OF_CAMERAS, URDF
from calibration.robot.exports.urdf import calibrated_urdf
from calibration.robot.robot_description import NO_INPUTS, XacroInputs, read_robot_description

CALIBRATED_URDF = "calibrated.urdf"


def exported(
    dataset: Dataset, formats: Sequence[str], description: Path | None, inputs: XacroInputs = NO_INPUTS
) -> tuple[dict[str, bytes], list[str]]:
    """Return the files of the requested formats by name, and notes for the user.

    Args:
        dataset: the calibrated dataset.
        formats: names of formats; empty for all that the dataset supports.
        description: the robot's URDF, or a xacro, which is expanded; None if there is none.
        inputs: what the expansion of a xacro needs.

    Raises:
        InputError: the dataset is not calibrated, the URDF does not match it, or the dataset does not support a
            requested format.
    """
    if URDF in formats and description is None:
        raise InputError(f"the format {URDF} needs the robot's own file: give robot-description")
    of = calibrated(dataset)
    files, notes = _texts(of, formats)
    if description is not None and (URDF in formats or not formats):
        made = calibrated_urdf(
            read_robot_description(description, inputs), {**of.transforms, **of.joints}, str(description)
        )
        files = {CALIBRATED_URDF: made.content} | files
        notes = [*made.notes, *notes]
    return files, notes


def _texts(of: Calibrated, formats: Sequence[str]) -> tuple[dict[str, bytes], list[str]]:
    """Return the files by name, and, if all formats are requested, those that the dataset does not support."""
    files: dict[str, bytes] = {}
    notes = []
    for name in FORMATS:
        if formats and name not in formats:
            continue
        if name not in OF_CAMERAS and not (of.transforms or of.joints):
            if formats:
                raise InputError(
                    f"'{name}' is of transforms, and none is calibrated, only cameras: {', '.join(OF_CAMERAS)}"
                )
            continue
        try:
            files |= {file: text.encode() for file, text in FILES[name](of).items()}
        except InputError as error:
            if formats:
                raise
            notes.append(f"no {name}: {error}")
    return files, notes
