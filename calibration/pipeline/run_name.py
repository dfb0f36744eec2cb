"""The name of a run in the cloud, kept in the output folder, so that the run can be resumed."""

from pathlib import Path

from calibration.errors import InputError
from calibration.execution.docker.labels import new_run
from calibration.files import read_bytes, write_atomically

FILE = "run.txt"
_MOST_BYTES = 1000


def name_of_run(output: Path, given: str | None, resume: bool) -> str:
    """The name that is given; else, to resume, that of the earlier run of an output folder; else a new one.

    It stands in the output folder afterwards.

    Raises:
        InputError: an earlier run is to be resumed, and nothing says which.
        WorldError: the file cannot be written.
    """
    path = output / FILE
    if given is None and resume:
        if not path.exists():
            raise InputError(f"resume: there is no {path}, which names the earlier run; give its name (run)")
        given = read_bytes(path, _MOST_BYTES, "the name of a run").decode("utf-8", "replace").strip()
    name = given if given is not None else new_run()
    write_atomically(path, f"{name}\n")
    return name
