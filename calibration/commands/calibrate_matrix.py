"""``calibrate-matrix``: every system from every noisy start, with a verdict."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click

from calibration.commands.parameters import (
    INTEGER_LIST,
    NON_NEGATIVE_LIST,
    TEXT_LIST,
    boolean_option,
    count,
    path,
    text,
)
from calibration.errors import ExitCode, InputError
from calibration.workflow import Runner

if TYPE_CHECKING:
    from calibration.pipeline.configuration import Configuration, System
    from calibration.pipeline.matrix.matrix import Matrix

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class Settings:
    """What ``calibrate-matrix`` is asked; None where the configuration, or its default, decides."""

    dataset: Path | None = None
    config: Path | None = None
    systems: tuple[str, ...] = ()
    translation_noise: tuple[float, ...] | None = None
    rotation_noise: tuple[float, ...] | None = None
    seeds: int | None = None
    seed_list: tuple[int, ...] | None = None
    start: Literal["linear", "given"] | None = None
    loss: Literal["huber", "linear"] | None = None
    evaluate: str | None = None
    truth: str | None = None
    compare: tuple[str, ...] = ()
    rules: Path | None = None
    image: str | None = None
    """What the team's software runs in; with it, or with a command, that calibrates in the place of our engine."""
    command: str | None = None
    artifacts: tuple[str, ...] = ()
    table: str | None = None
    calibrated: str | None = None
    ros: str | None = None
    memory: str | None = None
    timeout: str | None = None
    jobs: int | None = None
    fail_fast: bool = False
    output: Path = Path("output")


@click.command("calibrate-matrix")
@click.option("--dataset", type=path, help="A dataset's folder, or its JSON file; instead of config.")
@click.option("--config", type=path, help="A calibration.yml with the systems; instead of dataset.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems of the configuration.")
@click.option("--translation-noise", type=NON_NEGATIVE_LIST, help="Errors of the starting translations, m: 0,0.5.")
@click.option("--rotation-noise", type=NON_NEGATIVE_LIST, help="Errors of the starting Euler angles, rad: 0,0.5.")
@click.option("--seeds", type=count, help="How many seeds for each pair of noises (1).")
@click.option("--seed-list", type=INTEGER_LIST, help="The seeds themselves, instead of their number: 3,7.")
@click.option("--start", type=click.Choice(["linear", "given"]), help="Own linear start, or the noisy guess (linear).")
@click.option("--loss", type=click.Choice(["huber", "linear"]), help="Robust, or plain least squares (huber).")
@click.option("--evaluate", type=text, help="The table: rgb-to-rgb:SOURCE:TARGET, lidar-to-rgb:LIDAR:CAMERA, ...")
@click.option("--truth", type=text, help="ground_truth.json's path, dataset or none (the file beside the dataset).")
@click.option("--compare", type=TEXT_LIST, help="Other methods on the same data: opencv-stereo, shah, li.")
@click.option("--rules", type=path, help="YAML file of rules for the table of every cell.")
@click.option("--image", type=text, help="Image with the team's own calibration, which takes the place of our engine.")
@click.option(
    "--command", type=text, help="What it runs, without a shell: calibrate {start} {output} --seed {seed}; see README."
)
@click.option("--artifacts", type=TEXT_LIST, help="Files to bring out of it, with wildcards ({output}/*).")
@click.option("--table", type=text, help="Which of them is the table to judge (*.csv).")
@click.option("--calibrated", type=text, help="Which of them is the calibrated dataset, held against the truth.")
@click.option("--ros", type=click.Choice(["none", "1", "2"]), help="1 starts a ROS master beside it (none).")
@click.option("--memory", type=text, help="The most memory it may use, such as 2g (no limit).")
@click.option("--timeout", type=text, help="How long it may take, such as 10m (1h).")
@click.option("--jobs", type=count, help="Processes, or containers at once (one a core).")
@boolean_option("--fail-fast", help="The first cell that fails stops the others.")
@click.option("--output", type=path, default=Path("output"), help="Folder for results, tables and datasets (output).")
def command(**options: Any) -> ExitCode:
    """Calibrate systems from every noisy start; the verdict is fail when one of them is."""
    settings = Settings(**{name: value for name, value in options.items() if value is not None})
    return calibrate_matrix(settings, Runner.from_environment(os.environ))


def calibrate_matrix(settings: Settings, runner: Runner) -> ExitCode:
    """Run the matrix and report it.

    Raises:
        InputError: the settings contradict each other, or the data are wrong.
        WorldError: a result cannot be written.
    """
    from calibration.pipeline.stages import run_stages  # numpy and the engine, for those who need them

    results = run_stages(
        matrix_of(settings),
        settings.output,
        runner,
        "calibrate-matrix",
        settings.jobs,
        settings.fail_fast,
        ("calibrate", "introspect"),
    )
    return results.exit_code


def matrix_of(settings: Settings) -> "Matrix":
    """What is to be calibrated, from the configuration with the other settings in front.

    Raises:
        InputError: the settings contradict each other, or the configuration is wrong.
    """
    from calibration.pipeline.configuration import NoiseGrid, seed_range
    from calibration.pipeline.matrix.matrix import Matrix

    if (settings.dataset is None) == (settings.config is None):
        raise InputError("exactly one of dataset and config is to be given: a dataset's folder, or a calibration.yml")
    if settings.seeds is not None and settings.seed_list is not None:
        raise InputError("seeds and seed-list exclude each other: a number of seeds, or the seeds themselves")
    configuration = _configuration(settings)
    noise = configuration.noise
    seeds = settings.seed_list or (seed_range(settings.seeds) if settings.seeds else noise.seeds)
    systems = tuple(_adjusted(system, settings) for system in configuration.only(settings.systems))
    return Matrix(
        systems,
        NoiseGrid(
            _each_once(settings.translation_noise or noise.translations),
            _each_once(settings.rotation_noise or noise.rotations),
            _each_once(seeds),
        ),
        settings.start or configuration.start,
        settings.loss or configuration.loss,
    )


def _configuration(settings: Settings) -> "Configuration":
    from calibration.pipeline.configuration import Configuration, System, read_configuration

    if settings.config is not None:
        return read_configuration(settings.config)
    assert settings.dataset is not None  # noqa: S101 (checked by the caller)
    folder = settings.dataset.resolve()
    name = folder.parent.name if folder.suffix == ".json" else folder.name
    return Configuration((System(name, settings.dataset),))


def _adjusted(system: "System", settings: Settings) -> "System":
    """A system with what the settings say in the place of what the configuration says."""
    changes: dict[str, Any] = {
        name: value for name in ("evaluate", "truth", "compare") if (value := getattr(settings, name)) not in (None, ())
    }
    if settings.rules is not None:
        from calibration.introspection.rulesfile import read_rules

        changes["rules"] = read_rules(settings.rules)
    if entry := _software(settings):
        from calibration.pipeline.matrix.software import adjusted_software

        changes["software"] = adjusted_software(system.software, entry, Path.cwd())
    return replace(system, **changes)


def _software(settings: Settings) -> dict[str, Any]:
    """The settings about the team's software, as the keys of ``software`` in calibration.yml."""
    names = ("image", "command", "artifacts", "table", "calibrated", "ros", "memory", "timeout")
    return {name: value for name in names if (value := getattr(settings, name)) not in (None, ())}


def _each_once(values: tuple[_Value, ...]) -> tuple[_Value, ...]:
    return tuple(dict.fromkeys(values))
