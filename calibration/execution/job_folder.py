"""The folder of a job: what every backend leaves in it."""

import shutil
from pathlib import Path

from calibration.errors import WorldError
from calibration.execution.manifest import FILE_NAME

ARTIFACTS, LOGS = "artifacts", "logs"
"""Folders in a job's folder."""


def make_job_folder(folder: Path) -> None:
    """Make a job's folder; what an earlier run left there must not be taken for this one's.

    Raises:
        WorldError: it cannot be written.
    """
    try:
        for name in (ARTIFACTS, LOGS, FILE_NAME):
            place = folder / name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)
        (folder / LOGS).mkdir(parents=True)
    except OSError as error:
        raise WorldError(f"{folder}: cannot be written: {error.strerror or error}") from error
