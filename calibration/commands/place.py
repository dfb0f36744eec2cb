"""Where a command runs its containers, by its options ``backend``, ``aws-batch``, ``run`` and ``resume``."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calibration.errors import ExitCode, InputError
from calibration.workflow import Runner

if TYPE_CHECKING:
    from calibration.execution.backends import Place
    from calibration.execution.batch.settings import BatchSettings

DEFAULT_FILE = Path("calibration.yml")
"""Where the section aws-batch is looked for."""
KUBERNETES = "kubernetes"
"""What can be rendered; and the folder of it in the output folder."""
render_option = click.option(
    "--render",
    type=click.Choice([KUBERNETES]),
    help="kubernetes: run nothing, and write what would run on AWS Batch as Kubernetes takes it.",
)


def place(
    backend: str,
    file: Path | None,
    output: Path,
    run: str | None,
    resume: bool,
    runner: Runner,
    settings: "BatchSettings | None" = None,
    render: str | None = None,
) -> "Place":
    """Say where containers run.

    Args:
        backend: docker or aws-batch.
        file: with the section aws-batch; `DEFAULT_FILE` unless given.
        output: the folder of the results, where the name of the run is kept.
        run: the name of the run.
        resume: whether an earlier run is resumed.
        runner: where the name of the run is told.
        settings: of the section, where it has been read already; a file that is given goes first.
        render: kubernetes where the containers are not run, but written down for a cluster.

    Raises:
        InputError: the section is missing or wrong, nothing says which run is to be resumed, or options exclude each
            other.
        WorldError: the name of the run cannot be kept.
    """
    from calibration.execution.backends import AWS_BATCH, Place

    if render is not None and (backend != AWS_BATCH or resume):
        found = "resume" if resume else f"backend {backend}"
        raise InputError(f"render: writes what would run on {AWS_BATCH}, and runs nothing: leave out {found}")
    if backend != AWS_BATCH:
        return Place(backend, None, run)
    from calibration.execution.batch.section import read_section
    from calibration.pipeline.run_name import name_of_run

    if file is not None or settings is None:
        settings = read_section(file or DEFAULT_FILE)
    name = name_of_run(output, run, resume)
    if render is not None:
        return Place(backend, settings, name, render=output / render)
    runner.log(
        f"run {name} on AWS Batch, queue {settings.queue}; with --run {name} --resume only what is missing is run"
    )
    return Place(backend, settings, name, resume)


def run_or_render(work: Callable[[], ExitCode], runner: Runner) -> ExitCode:
    """Do the work of a command; where its containers are written down only, say where.

    Raises:
        CalibrationError: as the work.
    """
    from calibration.execution.backend import RenderedError

    try:
        return work()
    except RenderedError as rendered:
        runner.log(
            f"run {rendered.run}: {rendered.count} job{'s' * (rendered.count != 1)} for Kubernetes; what to do with "
            f"them: {rendered.folder / 'README.md'}"
        )
        return ExitCode.PASS
