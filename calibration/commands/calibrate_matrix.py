"""``calibrate-matrix``: every system from every noisy start, with a verdict."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

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
from calibration.commands.place import place
from calibration.commands.registry_password import EVERYWHERE, password_variable, registry_password_option
from calibration.errors import ExitCode, InputError
from calibration.execution.backends import AWS_BATCH, CONTAINERS, DOCKER, Place, check_backend
from calibration.image.pulling import pull_image
from calibration.introspection.rulesfile import read_rules
from calibration.pipeline.configuration import Configuration, read_configuration
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.matrix.software import adjusted_software
from calibration.pipeline.stages import Run, run_stages
from calibration.pipeline.system import NoiseGrid, System, seed_range
from calibration.registries.credentials import RegistrySettings
from calibration.workflow import Runner

TITLE = "calibrate-matrix"
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
    intrinsics: tuple[str, ...] = ()
    intrinsics_covariance: Path | None = None
    hold: tuple[str, ...] = ()
    image: str | None = None
    """What the team's software runs in; with it, or with a command, that calibrates in the place of our engine."""
    command: str | None = None
    artifacts: tuple[str, ...] = ()
    table: str | None = None
    calibrated: str | None = None
    ros: str | None = None
    memory: str | None = None
    timeout: str | None = None
    registry_username: str | None = None
    """Who pulls ``image``; nobody, or whom docker knows, where None."""
    password_variable: str | None = None
    backend: str | None = None
    """Where the software's containers run; what the configuration says, or docker, where None."""
    aws_batch: Path | None = None
    """The file with the section aws-batch; the configuration, or calibration.yml, where None."""
    run: str | None = None
    """The name of the run in the cloud."""
    resume: bool = False
    """Whether only what is missing of that run is run."""
    jobs: int | None = None
    fail_fast: bool = False
    output: Path = Path("output")


@click.command(TITLE)
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
@click.option("--compare", type=TEXT_LIST, help="Other methods on the same data: opencv-stereo, shah, tsai, icp, ...")
@click.option("--rules", type=path, help="YAML file of rules for the table of every cell.")
@click.option("--intrinsics", type=TEXT_LIST, help="Cameras whose intrinsics are calibrated too, or all.")
@click.option(
    "--intrinsics-covariance", type=path, help="JSON file of how well intrinsics are known: an earlier intrinsics.json."
)
@click.option(
    "--hold", type=TEXT_LIST, help="What stays as it is: sensors, transforms, patterns, intrinsics-left-k3 ..."
)
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
@click.option("--registry-username", type=text, help="User of the registry of image, where it is private.")
@registry_password_option
@click.option("--backend", type=text, help="Where its containers run: docker (this machine), or aws-batch (docker).")
@click.option("--aws-batch", type=path, help="YAML file with the section aws-batch (config, or calibration.yml).")
@click.option("--run", type=text, help="Name of the run on AWS Batch; a new one unless given.")
@boolean_option("--resume", help="On AWS Batch: run only what is missing of the run of this name, or into this folder.")
@click.option("--jobs", type=count, help="Processes, or containers at once (one a core).")
@boolean_option("--fail-fast", help="The first cell that fails stops the others.")
@click.option("--output", type=path, default=Path("output"), help="Folder for results, tables and datasets (output).")
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Calibrate systems from every noisy start; the verdict is fail when one of them is."""
    runner = Runner.from_environment(os.environ)
    options["password_variable"] = password_variable(click_context, options.pop("registry_password"), runner)
    settings = Settings(**{name: value for name, value in options.items() if value is not None})
    return calibrate_matrix(settings, runner)


def calibrate_matrix(settings: Settings, runner: Runner) -> ExitCode:
    """Run the matrix and report it.

    Raises:
        InputError: the settings contradict each other, or the data are wrong.
        WorldError: a result cannot be written.
    """
    matrix = matrix_of(settings)
    place = place_of(settings, matrix, runner)
    pull(settings, runner)
    run = Run(matrix, settings.output, runner, TITLE, settings.jobs, settings.fail_fast, place=place)
    return run_stages(run, ("calibrate", "introspect")).exit_code


def place_of(settings: Settings, matrix: Matrix, runner: Runner) -> Place:
    """Where the team's software runs.

    Raises:
        InputError: there is no such backend, no software to run in it, or nothing says where in the cloud.
    """
    configuration = _configuration(settings)
    backend = settings.backend or configuration.backend
    check_backend(backend, CONTAINERS)
    in_cloud = backend == AWS_BATCH and bool(matrix.software)
    if not in_cloud and settings.backend == AWS_BATCH:
        raise InputError(f"backend: found {AWS_BATCH}, which runs the team's own software: give image and command")
    if not in_cloud and (settings.run is not None or settings.resume):
        raise InputError(f"{'run' if settings.run is not None else 'resume'}: is for the backend {AWS_BATCH}")
    if in_cloud and settings.registry_username is not None:
        raise InputError(f"registry-username: {AWS_BATCH} pulls with its execution role; push the image to ECR")
    return place(
        backend if in_cloud else DOCKER,
        settings.aws_batch,
        settings.output,
        settings.run,
        settings.resume,
        runner,
        configuration.batch,
    )


def pull(settings: Settings, runner: Runner) -> None:
    """Pull the image that is given with a login; the backend then finds it on the engine."""
    if settings.registry_username is None and settings.password_variable in (None, EVERYWHERE):
        return  # nothing was asked: that variable may be there for other commands
    if settings.registry_username is None or settings.password_variable is None:
        missing = "registry-username" if settings.registry_username is None else "registry-password"
        raise InputError(f"{missing} is not given: user and password go together")
    if settings.image is None:
        raise InputError("registry-username is given without the image that it is for")

    login = RegistrySettings(username=settings.registry_username, password_variable=settings.password_variable)
    pull_image(settings.image, login, runner, TITLE)


def matrix_of(settings: Settings) -> Matrix:
    """What is to be calibrated, from the configuration with the other settings in front.

    Raises:
        InputError: the settings contradict each other, or the configuration is wrong.
    """
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


def _configuration(settings: Settings) -> Configuration:

    if settings.config is not None:
        return read_configuration(settings.config)
    assert settings.dataset is not None  # noqa: S101 (checked by the caller)
    folder = settings.dataset.resolve()
    name = folder.parent.name if folder.suffix == ".json" else folder.name
    return Configuration((System(name, settings.dataset),))


def _adjusted(system: System, settings: Settings) -> System:
    """A system with what the settings say in the place of what the configuration says."""
    changes: dict[str, Any] = {
        name: value for name in _OF_A_SYSTEM if (value := getattr(settings, name)) not in (None, ())
    }
    if settings.rules is not None:
        changes["rules"] = read_rules(settings.rules)
    if entry := _software(settings):
        changes["software"] = adjusted_software(system.software, entry, Path.cwd())
    return replace(system, **changes)


_OF_A_SYSTEM = ("evaluate", "truth", "compare", "intrinsics", "intrinsics_covariance", "hold")
"""Settings that stand in the place of a system's own."""


def _software(settings: Settings) -> dict[str, Any]:
    """The settings about the team's software, as the keys of ``software`` in calibration.yml."""
    names = ("image", "command", "table", "calibrated", "ros", "memory", "timeout")
    given = {name: value for name in names if (value := getattr(settings, name)) is not None}
    return given | ({"artifacts": list(settings.artifacts)} if settings.artifacts else {})


def _each_once(values: tuple[_Value, ...]) -> tuple[_Value, ...]:
    return tuple(dict.fromkeys(values))
