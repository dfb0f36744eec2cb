"""``next-pose``: what to record next, until the limits of a calibration are decided."""

from pathlib import Path

import click

from calibration.base import ExitCode, InputError
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import TEXT_LIST, count, integer, path
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.next_poses import COUNT, advise_system, next_poses_report

MAX_POSES = 40
"""Limit of the poses that are advised."""


@click.command("next-pose")
@click.option("--config", type=path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems (all).")
@click.option("--count", "poses", type=count, default=COUNT, show_default=True, help="Poses to advise.")
@click.option("--seed", type=integer, default=1, show_default=True, help="Of the poses that are looked at.")
@click.option("--output", type=path, default="output/next-pose", show_default=True, help="Folder for the poses.")
def command(config: Path, systems: tuple[str, ...] | None, poses: int, seed: int, output: Path) -> ExitCode:
    """Say which poses to record next, what they are expected to bring, and when it is enough.

    Writes them as a motion file, as joint positions and transforms, and as a page with pictures.
    """
    runner = Runner.from_environment()
    if poses > MAX_POSES:
        raise InputError(f"--count: found {poses}, expected {MAX_POSES} at most")
    advised = {
        system.name: advise_system(system, poses, seed) for system in read_configuration(config).only(systems or ())
    }
    publish(next_poses_report(advised), runner, output)
    return ExitCode.PASS
