"""Execution target of a command, by its options ``backend``, ``aws-batch``, ``run`` and ``resume``."""

from pathlib import Path

from calibration.base import InputError, read_bytes, write_atomically
from calibration.ci.execution.backends import SECTIONS, ExecutionTarget, Sections, read_sections
from calibration.ci.execution.docker.labels import new_run
from calibration.ci.workflow import Runner

DEFAULT_FILE = Path("calibration.yml")
"""Default file with the section aws-batch."""
RUN_FILE = "run.txt"
"""File in the output folder with the name of the run, to resume it."""
_MAX_RUN_FILE_BYTES = 1000


def execution_target(
    backend: str,
    file: Path | None,
    output: Path,
    run: str | None,
    resume: bool,
    runner: Runner,
    sections: Sections | None = None,
) -> ExecutionTarget:
    """Return the execution target of containers.

    Args:
        backend: docker or aws-batch.
        file: file with the section aws-batch; by default `DEFAULT_FILE`.
        output: folder of the results, where the name of the run is saved.
        run: name of the run.
        resume: whether an earlier run is resumed.
        runner: runner whose log reports the name of the run.
        sections: sections of the configuration, if it has been read; a file that is given takes precedence.

    Raises:
        InputError: the section is missing or wrong, or the run to resume is unknown.
        InfrastructureError: the name of the run cannot be saved.
    """
    if backend not in SECTIONS:
        return ExecutionTarget(backend, run=run)
    if file is not None or sections is None or sections.of(backend) is None:
        sections = read_sections(backend, file or DEFAULT_FILE)
    name = name_of_run(output, run, resume)
    runner.log(
        f"run {name} on {sections.of(backend).where}; with --run-name {name} --resume only what is missing is run"
    )
    return ExecutionTarget(backend, sections, name, resume)


def name_of_run(output: Path, given: str | None, resume: bool) -> str:
    """Return the given name of a run; to resume, the name saved in the output folder; otherwise a new name.

    The name is saved in the output folder.

    Raises:
        InputError: a run is to be resumed, and no name is given or saved.
        InfrastructureError: the file cannot be written.
    """
    path = output / RUN_FILE
    if given is None and resume:
        if not path.exists():
            raise InputError(f"resume: there is no {path}, which names the earlier run; give its name (run)")
        given = read_bytes(path, _MAX_RUN_FILE_BYTES, "the name of a run").decode("utf-8", "replace").strip()
    name = given if given is not None else new_run()
    write_atomically(path, f"{name}\n")
    return name
