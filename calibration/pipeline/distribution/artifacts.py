"""Artifacts of a workflow's jobs, as the last job has downloaded them."""

from pathlib import Path

from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import read_bytes
from calibration.pipeline.distribution.plan import PLAN, Plan
from calibration.pipeline.distribution.plan_outputs import plan_of_text

PLAN_FILE = "plan.json"
MAX_PLAN_BYTES = 4 * 1024**2
"""Limit of the plan's file: 256 jobs with long paths take half a megabyte."""


def read_plan(folder: Path, sha256: str) -> Plan:
    """Read the plan from its artifact.

    Where it is the only artifact its file is in the folder itself: download-artifact makes a folder for each of
    several artifacts, but none for a single one.

    Raises:
        InputError: it is missing, or is not the file with this hash.
    """
    path = folder / PLAN / PLAN_FILE
    path = path if path.exists() else folder / PLAN_FILE
    if not path.exists():
        raise InputError(f"{path}: the plan is missing: did the job plan keep its artifact?")
    return plan_of_text(read_bytes(path, MAX_PLAN_BYTES, "a plan").decode(errors="replace"), sha256)


def name_folders_by_slug(folder: Path, artifact_name: str) -> None:
    """Rename the folders of artifacts, NAME~SLUG, to the slugs alone; other files of the folder are not touched.

    Raises:
        InfrastructureError: one cannot be renamed.
    """
    prefix = f"{artifact_name}~"
    for path in sorted(folder.glob(f"{prefix}*")):
        try:
            path.rename(folder / path.name.removeprefix(prefix))
        except OSError as error:
            raise InfrastructureError(f"{path}: cannot be renamed: {error.strerror}") from error
