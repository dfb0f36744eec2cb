"""``record-motion``: record a motion sequence by hand on a page in the browser."""

import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.ci.workflow import Runner
from calibration.commands.parameters import boolean_option, integer, path, system_folder, text

MAX_PORT = 65535


def port_number(value: str | int) -> int:
    """Parse a port, 0 for any free one; a usage error for anything else."""
    port = integer(value)
    if not 0 <= port <= MAX_PORT:
        raise click.BadParameter(f"{value!r} is not a port from 0 to {MAX_PORT}")
    return port


@dataclass(frozen=True)
class RecorderSettings:
    """Inputs of ``record-motion``."""

    system: str
    """Name of a system in ``datasets/``, or its folder."""
    robot: Path | None = None
    config: Path | None = None
    motion: Path | None = None
    """Initial motion sequence."""
    output: Path = Path("motion.json")
    host: str = "127.0.0.1"
    port: int = 8080
    open: bool = False
    overwrite: bool = False


@click.command("record-motion")
@click.option("--system", type=text, required=True, help="Name of a system in datasets/, or the folder of one.")
@click.option("--robot", type=path, help="URDF or xacro, in place of the system's robot.urdf.")
@click.option("--config", type=path, help="ATOM's calibration configuration, in place of the system's config.yml.")
@click.option("--motion", type=path, help="Motion sequence (JSON) to begin with.")
@click.option(
    "--output", type=path, default="motion.json", show_default=True, help="File that the sequence is exported to."
)
@click.option(
    "--host", type=text, default="127.0.0.1", show_default=True, help="Address to serve the page on; this machine only."
)
@click.option("--port", type=port_number, default=8080, show_default=True, help="Port of the page; 0 for a free one.")
@boolean_option("--overwrite", help="Let the page replace motion files that it has not written.")
@boolean_option("--open", help="Open the page in the browser.")
def command(**options: Any) -> ExitCode:
    """Record a motion sequence on a page in the browser: drag the pattern, see what the cameras see, save."""
    settings = RecorderSettings(**{name: value for name, value in options.items() if value is not None})
    return record_motion(settings, Runner.from_environment(os.environ))


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
