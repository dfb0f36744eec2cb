"""``record-motion``: record a motion sequence by hand on a page in the browser."""

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.base.records import between, field, record
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options, system_folder


@record(kw_only=True)
class RecorderSettings:
    """Inputs of ``record-motion``."""

    system: str = field("Name of a system in datasets/, or the folder of one.")
    robot: Path | None = field("URDF or xacro, in place of the system's robot.urdf.", default=None)
    config: Path | None = field("ATOM's calibration configuration, in place of the system's config.yml.", default=None)
    motion: Path | None = field("Motion sequence (JSON) to begin with.", default=None)
    output: Path = field("File that the sequence is exported to (motion.json).", default=Path("motion.json"))
    host: str = field("Address to serve the page on (127.0.0.1); this machine only.", default="127.0.0.1")
    port: Annotated[int, between(0, 65535)] = field("Port of the page; 0 for a free one (8080).", default=8080)
    overwrite: bool = field("Let the page replace motion files that it has not written.", default=False)
    open: bool = field("Open the page in the browser.", default=False)


@click.command("record-motion")
@record_options(RecorderSettings, required=True)
def command(**options: Any) -> ExitCode:
    """Record a motion sequence on a page in the browser: drag the pattern, see what the cameras see, save."""
    return record_motion(chosen(RecorderSettings, options), Runner.from_environment(os.environ))


def record_motion(settings: RecorderSettings, runner: Runner) -> ExitCode:
    """Serve the page until the command is stopped; then save poses that are not in a file beside the output.

    Raises:
        InputError: an input is missing or wrong.
        InfrastructureError: viser is not installed, the port is in use, or a file cannot be written.
    """
    if find_spec("viser") is None:
        raise InfrastructureError("record-motion needs viser: pip install viser")
    if settings.output.is_dir():
        raise InputError(f"{settings.output}: is a folder, expected a file for the sequence")
    from calibration.addons.recorder.recording import record  # needs the extra record, slow to import

    record(settings, system_folder(settings.system), runner)
    return ExitCode.PASS
