"""How long a job took, as the job itself says it: a whole number of seconds in an output, or in its artifact."""

import re
from pathlib import Path

from calibration.errors import CalibrationError
from calibration.files import read_bytes

FILE = "job-seconds.txt"
"""Beside the results of a job of the matrix, of which GitHub keeps no outputs one by one."""
_SECONDS = re.compile(r"[0-9]{1,7}")
"""No job runs for longer than 115 days."""


def parse_seconds(value: object) -> int | None:
    """The seconds that a job says; None for anything else, which is no reason to fail."""
    text = value.strip() if isinstance(value, str) else ""
    return int(text) if _SECONDS.fullmatch(text) else None


def read_seconds(folder: Path) -> int | None:
    """What a job has left in its folder; None where it has left nothing, or something else."""
    try:
        return parse_seconds(read_bytes(folder / FILE, 16, "a number of seconds").decode("latin-1"))
    except CalibrationError:
        return None
