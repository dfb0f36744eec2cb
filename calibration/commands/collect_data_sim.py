"""``collect-data-sim``: a system and a motion to a dataset, in simulation."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from calibration.commands.parameters import boolean_option, path, text
from calibration.errors import ExitCode, InputError
from calibration.workflow import Runner, set_outputs, stop_commands

if TYPE_CHECKING:
    from calibration.simulation.collection.capture import SimulatedCollection
    from calibration.simulation.motion.sequence import Motion
    from calibration.simulation.system import System

SYSTEMS = Path("datasets")
"""Where the name of a system is looked up, from the working directory."""
BACKENDS = ("embedded",)
MAX_POSES = 1000
"""No longer motion is generated."""


def seed_number(value: str | int) -> int:
    """Read a seed, a whole number that is not below 0; a usage error for anything else."""
    try:
        seed = int(value)
    except ValueError:
        seed = -1
    if seed < 0:
        raise click.BadParameter(f"{value!r} is not a whole number of at least 0")
    return seed


@dataclass(frozen=True)
class Settings:
    """What ``collect-data-sim`` is asked."""

    system: str
    """The name of a system in `SYSTEMS`, or a folder."""
    output: Path
    robot: Path | None = None
    config: Path | None = None
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    seed: int = 1
    backend: str = "embedded"
    overwrite: bool = False


@click.command("collect-data-sim")
@click.option("--system", type=text, required=True, help="Name of a system in datasets/, or the folder of one.")
@click.option("--robot", type=path, help="URDF file, in place of the system's robot.urdf.")
@click.option("--config", type=path, help="ATOM's calibration configuration, in place of the system's config.yml.")
@click.option(
    "--motion", type=text, help="Motion sequence (JSON), or generate:N; the system's motion.json unless given."
)
@click.option(
    "--seed", type=seed_number, default=1, show_default=True, help="Seed of the noise and of a generated motion."
)
@click.option("--backend", type=text, default="embedded", show_default=True, help="What simulates: embedded.")
@click.option("--output", type=path, required=True, help="Folder for the dataset.")
@boolean_option("--overwrite", help="Replace a dataset that the folder has.")
def command(**options: Any) -> ExitCode:
    """Collect a dataset in simulation, with labels and point clouds, and the truth beside it."""
    return collect_data_sim(Settings(**options), Runner.from_environment(os.environ))


def collect_data_sim(settings: Settings, runner: Runner) -> ExitCode:
    """Collect the dataset, say what each sensor detected, and write the folder.

    Raises :class:`InputError` when an input is missing or wrong, or the folder has a dataset already,
    and :class:`calibration.errors.WorldError` when the folder cannot be written; it is then as before.
    """
    from calibration.simulation.collection.capture import collect
    from calibration.simulation.collection.dataset_folder import refuse_existing, write_dataset_folder
    from calibration.simulation.system import read_system

    if settings.backend not in BACKENDS:
        raise InputError(f"backend: found '{settings.backend}', expected {' or '.join(BACKENDS)}")
    folder = system_folder(settings.system)
    refuse_existing(settings.output, settings.overwrite)
    system = read_system(folder, settings.robot, settings.config)
    motion = _motion(settings, folder, system)
    collections: list[SimulatedCollection] = []
    with stop_commands(runner):  # names in files that others wrote
        runner.log(f"{system.name}: {len(motion)} poses of {motion.source}, seed {settings.seed}")
        for collection in collect(system, motion, settings.seed):
            collections.append(collection)
            runner.log(f"{len(collections):4d}/{len(motion)}  {_seen(system, collection)}")
        for line in _totals(system, collections):
            runner.log(line)
    write_dataset_folder(settings.output, system, motion, collections, settings.seed, settings.overwrite)
    runner.log(f"{len(collections)} collections in {settings.output}")
    set_outputs(
        runner,
        {
            "dataset": settings.output,
            "collections": len(collections),
            "detections": {name: sum(c.detected(name) for c in collections) for name in system.sensors},
        },
    )
    return ExitCode.PASS


def system_folder(system: str) -> Path:
    """The folder of a system, by its name in `SYSTEMS` or by its path.

    Raises :class:`InputError` when there is none.
    """
    for folder in (SYSTEMS / system, Path(system)):
        if system and folder.is_dir():
            return folder
    known = sorted(folder.parent.name for folder in SYSTEMS.glob("*/simulation.yml"))
    names = f"one of {', '.join(known)} or a folder" if known else "a folder"
    raise InputError(f"system: found '{system}', expected {names}")


def _motion(settings: Settings, folder: Path, system: "System") -> "Motion":
    from calibration.simulation.motion.generation import generate_motion
    from calibration.simulation.motion.sequence import read_motion
    from calibration.simulation.system import MOTION_FILE

    if settings.motion is None:
        if not (folder / MOTION_FILE).exists():
            raise InputError(f"{folder / MOTION_FILE}: does not exist; give a motion: a file or generate:N")
        return read_motion(folder / MOTION_FILE)
    if not settings.motion.startswith("generate:"):
        return read_motion(Path(settings.motion))
    count = settings.motion.removeprefix("generate:")
    if not re.fullmatch(r"[0-9]{1,9}", count) or not 1 <= int(count) <= MAX_POSES:
        raise InputError(f"motion: found '{settings.motion}', expected generate:N with N from 1 to {MAX_POSES}")
    return generate_motion(system, int(count), settings.seed)


def _seen(system: "System", collection: "SimulatedCollection") -> str:
    """What each sensor detected in one collection."""
    words = []
    for (pattern, sensor), corners in collection.corners.items():
        count, total = len(corners.ids) if corners else 0, len(system.patterns[pattern].corners)
        words.append(f"{sensor} {count}/{total} corners" if corners else f"{sensor} not detected")
    for (_, sensor), points in collection.points.items():
        words.append(f"{sensor} {len(points.on_pattern)} points" if points else f"{sensor} not detected")
    return ", ".join(words)


def _totals(system: "System", collections: "list[SimulatedCollection]") -> list[str]:
    """What each sensor detected in all collections."""
    lines = []
    for sensor in system.sensors:
        partial = sum(
            labels is not None and name == sensor and len(labels.ids) < len(system.patterns[pattern].corners)
            for collection in collections
            for (pattern, name), labels in collection.corners.items()
        )
        detected = sum(collection.detected(sensor) for collection in collections)
        some = f", {partial} of them in part" if partial else ""
        lines.append(f"{sensor}: detected in {detected} of {len(collections)} collections{some}")
    return lines
