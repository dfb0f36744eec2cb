"""Where a command runs its containers, by its options ``backend``, ``aws-batch``, ``run`` and ``resume``."""

from pathlib import Path

from calibration.errors import InputError
from calibration.execution.backends import KINDS, Place, Sections, read_sections
from calibration.files import read_bytes, write_atomically
from calibration.workflow import Runner

DEFAULT_FILE = Path("calibration.yml")
"""Where the section aws-batch is looked for."""
RUN_FILE = "run.txt"
"""Keeps the name of a run in the output folder, so that the run can be resumed."""
_MOST_BYTES = 1000


def place(
    backend: str,
    file: Path | None,
    output: Path,
    run: str | None,
    resume: bool,
    runner: Runner,
    sections: Sections | None = None,
) -> Place:
    """Say where containers run.

    Args:
        backend: docker or aws-batch.
        file: with the section aws-batch; `DEFAULT_FILE` unless given.
        output: the folder of the results, where the name of the run is kept.
        run: the name of the run.
        resume: whether an earlier run is resumed.
        runner: where the name of the run is told.
        sections: of the configuration, where it has been read already; a file that is given goes first.

    Raises:
        InputError: the section is missing or wrong, or nothing says which run is to be resumed.
        InfrastructureError: the name of the run cannot be kept.
    """
    if not KINDS[backend].settings:
        return Place(backend, run=run)
    if file is not None or sections is None or sections.of(backend) is None:
        sections = read_sections(backend, file or DEFAULT_FILE)
    name = name_of_run(output, run, resume)
    runner.log(f"run {name} on {sections.of(backend).where}; with --run {name} --resume only what is missing is run")
    return Place(backend, sections, name, resume)


def name_of_run(output: Path, given: str | None, resume: bool) -> str:
    """The name that is given; else, to resume, that of the earlier run of an output folder; else a new one.

    It stands in the output folder afterwards.

    Raises:
        InputError: an earlier run is to be resumed, and nothing says which.
        InfrastructureError: the file cannot be written.
    """
    path = output / RUN_FILE
    if given is None and resume:
        if not path.exists():
            raise InputError(f"resume: there is no {path}, which names the earlier run; give its name (run)")
        given = read_bytes(path, _MOST_BYTES, "the name of a run").decode("utf-8", "replace").strip()
    if given is None:
        from calibration.execution.docker.labels import new_run  # brings sockets, which most runs need not

        given = new_run()
    name = given
    write_atomically(path, f"{name}\n")
    return name
