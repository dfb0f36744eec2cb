"""Reference for "before": the package at a kept commit, measured in the same run."""

import atexit
import subprocess
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.shared_data import ROOT

COMMIT = "51bef2e"
"""Before the work on speed began; its package runs with today's dependencies."""
RECENT = "82e9c42"
"""The same for what had another interface at `COMMIT`: datasets in memory, simulated sensors."""
_FOLDERS = ExitStack()
atexit.register(_FOLDERS.close)


@cache
def folder(commit: str = COMMIT) -> Path | None:
    """A folder with the package of a commit; None where the repository's history is not there."""
    archive = subprocess.run(["git", "archive", commit, "calibration"], cwd=ROOT, capture_output=True)
    if archive.returncode:
        return None
    place = Path(_FOLDERS.enter_context(TemporaryDirectory(prefix="calibration-before-")))
    subprocess.run(["tar", "x"], cwd=place, input=archive.stdout, check=True)
    return place


def python(program: str, place: Path) -> list[str]:
    """The arguments of a Python process that takes the package from a folder."""
    return ["-c", f"import sys; sys.path.insert(0, {str(place)!r}); {program}"]
