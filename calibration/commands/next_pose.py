"""``next-pose``, ``plan-recording``: what to record next, and before anything is recorded."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, InputError
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.commands import parameters
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import ALL_EXACT, Assumptions, Options
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.next_poses import COUNT, advise_system, next_poses_report, plan
from calibration.robot.importing.printed_sheet import PAPER_SIZES_MM, board_sheet, pdf, svg
from calibration.robot.simulation.system import read_system

MAX_POSES = 40
"""Limit of the poses that are advised or planned."""


@click.command("next-pose")
@click.option("--config", type=parameters.path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--systems", type=parameters.TEXT_LIST, help="Only these systems (all).")
@click.option("--count", "poses", type=parameters.count, default=COUNT, show_default=True, help="Poses to advise.")
@click.option("--seed", type=parameters.integer, default=1, show_default=True, help="Of the poses that are looked at.")
@click.option(
    "--output", type=parameters.path, default="output/next-pose", show_default=True, help="Folder for the poses."
)
def next_pose_command(config: Path, systems: tuple[str, ...] | None, poses: int, seed: int, output: Path) -> ExitCode:
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


OF_LIMITS = ("translation-mm", "rotation-deg", "joint-mm", "joint-deg", "guard-band")


@click.command("plan-recording")
@click.option("--system", required=True, help="Folder with robot.urdf, config.yml, simulation.yml; or of datasets/.")
@parameters.record_options(Limits, *OF_LIMITS)
@parameters.boolean_option(
    "--exact", help="Take what is held as exactly known: camera_info, the board, the arm's links."
)
@click.option(
    "--count", "poses", type=parameters.count, help="Poses to plan (as many as the limits take, from 8 to 40)."
)
@click.option("--seed", type=parameters.integer, default=1, show_default=True, help="Of the poses that are looked at.")
@click.option("--paper", type=click.Choice(list(PAPER_SIZES_MM)), help="Write the boards too, on this paper.")
@click.option("--output", type=parameters.path, default="output/plan", show_default=True, help="Folder for the plan.")
def plan_recording_command(
    system: str, exact: bool, poses: int | None, seed: int, paper: str | None, output: Path, **options: Any
) -> ExitCode:
    """Plan the poses of a recording from a robot's description and its sensors; nominal poses are enough.

    Says how many poses the limits take, and writes them as a motion file, as joint positions and transforms, and as a
    page with pictures.
    """
    runner = Runner.from_environment()
    if poses is not None and poses > MAX_POSES:
        raise InputError(f"--count: found {poses}, expected {MAX_POSES} at most")
    described = read_system(parameters.system_folder(system))
    limits = parameters.chosen(Limits, options) if parameters.given(Limits, options, *OF_LIMITS) else Limits()
    advised = plan(described, limits, Options(assume=ALL_EXACT if exact else Assumptions()), poses, seed)
    report = next_poses_report({described.name: advised})
    files: dict[str, str | bytes] = {}
    for name, pattern in described.configuration.patterns.items() if paper else ():
        sheet = board_sheet(pattern, paper or "")
        files |= {f"{name}.svg": svg(sheet), f"{name}.pdf": pdf(sheet)}
    publish(replace(report, files={**report.files, **files}), runner, output)
    return ExitCode.PASS
