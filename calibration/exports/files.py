"""All files of some formats, for a calibrated dataset and, where it is given, the robot's description."""

from collections.abc import Sequence
from pathlib import Path

from calibration.dataset.model import Dataset
from calibration.errors import InputError
from calibration.exports.calibrated import Calibrated, calibrated
from calibration.exports.formats import FORMATS, URDF
from calibration.exports.urdf import calibrated_urdf
from calibration.files import read_bytes

LARGEST_URDF = 50_000_000
CALIBRATED_URDF = "calibrated.urdf"


def exported(dataset: Dataset, formats: Sequence[str], description: Path | None) -> tuple[dict[str, bytes], list[str]]:
    """The files of formats by their names, and what a user should know of them.

    Args:
        dataset: the calibrated one.
        formats: their names; none for all that these data can have.
        description: the robot's URDF; None for none.

    Raises:
        InputError: a dataset that is not calibrated, a URDF that does not fit it, a format that is asked for and that
            these data cannot have.
    """
    if URDF in formats and description is None:
        raise InputError(f"the format {URDF} needs the robot's own file: give robot-description")
    of = calibrated(dataset)
    files, notes = _texts(of, formats)
    if description is not None and (URDF in formats or not formats):
        made = calibrated_urdf(
            read_bytes(description, LARGEST_URDF, "a URDF"), {**of.transforms, **of.joints}, str(description)
        )
        files = {CALIBRATED_URDF: made.content} | files
        notes = [*made.notes, *notes]
    return files, notes


def _texts(of: Calibrated, formats: Sequence[str]) -> tuple[dict[str, bytes], list[str]]:
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
