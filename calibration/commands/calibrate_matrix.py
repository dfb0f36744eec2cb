"""``calibrate-matrix``: calibrate every system from every noisy start, with a verdict."""

from collections.abc import Mapping
from dataclasses import field as dataclass_field
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from calibration.base import ExitCode, InputError
from calibration.base.records import at_least, changed, field, read, record
from calibration.ci.execution.backends import (
    CLOUDS,
    CLOUDS_TEXT,
    CONTAINER_BACKENDS,
    DOCKER,
    ExecutionTarget,
    check_backend,
)
from calibration.ci.introspection import read_rules
from calibration.ci.registries.reference import RegistrySettings
from calibration.ci.workflow import Runner
from calibration.commands.parameters import (
    NOISE_OPTION_OF_KEY,
    PASSWORD_VARIABLE,
    chosen,
    given,
    password_variable,
    record_options,
    registry_password_option,
)
from calibration.commands.target import execution_target
from calibration.pipeline.containers import Software, adjusted_software
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.repetition.repetition import Repetitions
from calibration.pipeline.repetition.running import repeat_stages
from calibration.pipeline.running import PipelineRun
from calibration.pipeline.system import Noise, NoiseGrid, System, chosen_systems

if TYPE_CHECKING:
    from calibration.pipeline.configuration import PipelineConfiguration

COMMAND_NAME = "calibrate-matrix"
OF_SOFTWARE = {
    "image": "Image with the team's own calibration, used instead of our engine.",
    "command": "Command, without a shell: calibrate {start} {output} --seed {seed}.",
    "artifacts": "Files to copy out of the container, with wildcards ({output}/*).",
    "table": "The table among them to check (*.csv).",
    "calibrated": "The calibrated dataset among them to evaluate (*.json); none: only its table is used.",
    "ros": "1 starts a ROS master beside it (none).",
    "memory": "Memory limit, such as 2g (no limit).",
    "timeout": "Time limit, such as 10m (1h).",
}
"""Keys of the team's software that are options, with their help."""


@record(kw_only=True)
class MatrixSettings:
    """Inputs of ``calibrate-matrix``; for empty ones and None the configuration or its default applies."""

    dataset: Path | None = field("A dataset's folder, or its JSON file; instead of config.", default=None)
    config: Path | None = field("A calibration.yml with the systems; instead of dataset.", default=None)
    systems: tuple[str, ...] = field("Only these systems of the configuration.", default=())
    noise: Noise = Noise()
    of_systems: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Keys of systems that replace those of the configuration."""
    rules: Path | None = field("YAML file of rules for the table of every cell.", default=None)
    software: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Keys of the team's software that replace those of the configuration."""
    registry_username: str | None = field("User of the registry of image, if it is private.", default=None)
    password_variable: str | None = None
    backend: str | None = field("Where its containers run: docker (this machine), or aws-batch (docker).", default=None)
    aws_batch: Path | None = field("YAML file with the section aws-batch (config, or calibration.yml).", default=None)
    run_name: str | None = field("Name of the run on AWS Batch (a new one).", default=None, formerly="run")
    resume: bool = field(
        "On AWS Batch: run only what is missing of the run of this name, or into this folder.", default=False
    )
    parallel: Annotated[int, at_least(1)] | None = field(
        "Number of parallel processes or containers (one per core).", default=None, formerly="jobs"
    )
    fail_fast: bool = field("The first cell that fails stops the others.", default=False)
    output: Path = field("Folder for results, tables and datasets (output).", default=Path("output"))
    repetitions: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Keys of `Repetitions` that replace those of the configuration."""

    @classmethod
    def of_options(cls, options: Mapping[str, Any]) -> "MatrixSettings":
        """Create the settings from the options of a command."""
        return chosen(
            cls,
            options,
            noise=read(Noise, given(Noise, options, names=NOISE_OPTION_OF_KEY), "options"),
            of_systems=given(System, options),
            software=given(Software, options, *OF_SOFTWARE),
            password_variable=options.get("password_variable"),
            repetitions=given(Repetitions, options),
        )


@click.command(COMMAND_NAME)
@record_options(MatrixSettings, "dataset", "config", "systems")
@record_options(Noise, "translation", "rotation", "seeds", names=NOISE_OPTION_OF_KEY)
@record_options(Noise, "seed-list", instead="noise")
@record_options(System, instead="systems.NAME")
@record_options(MatrixSettings, "rules", instead="systems.NAME", written="what the file has")
@record_options(Software, "image", helps=OF_SOFTWARE)
@record_options(Software, *list(OF_SOFTWARE)[1:], helps=OF_SOFTWARE, instead="systems.NAME.software")
@record_options(MatrixSettings, "registry-username")
@registry_password_option
@record_options(MatrixSettings, "backend", instead="")
@record_options(MatrixSettings, "aws-batch", instead="", written="what the file has")
@record_options(MatrixSettings, "run-name", "resume", "parallel", "fail-fast", "output")
@record_options(Repetitions, "repeat")
@record_options(Repetitions, "max-flake-rate", instead="")
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Calibrate systems from every noisy start; the verdict is fail if one of them fails."""
    runner = Runner.from_environment()
    options["password_variable"] = password_variable(click_context, options.pop("registry_password"), runner)
    settings = MatrixSettings.of_options(options)
    configuration = configuration_of(settings)
    matrix = matrix_of(settings, configuration)
    target = target_of(settings, configuration, matrix, runner)
    pull(settings, runner)
    baseline = configuration.baseline if configuration else None
    run = PipelineRun(
        matrix,
        settings.output,
        runner,
        COMMAND_NAME,
        settings.config,
        settings.parallel,
        settings.fail_fast,
        baseline=baseline,
        target=target,
    )
    known = configuration.repetitions if configuration else Repetitions()
    repetitions = changed(known, settings.repetitions, "options")
    return repeat_stages(run, ("calibrate", "introspect", "export"), repetitions)[0]


def target_of(
    settings: MatrixSettings, configuration: "PipelineConfiguration | None", matrix: Matrix, runner: Runner
) -> ExecutionTarget:
    """Return the execution target of the team's software.

    Raises:
        InputError: unknown backend, a cloud backend without software to run, or without its section of settings.
    """
    backend = settings.backend or (configuration.backend if configuration else DOCKER)
    check_backend(backend, CONTAINER_BACKENDS)
    in_cloud = backend in CLOUDS and bool(matrix.software)
    if not in_cloud and settings.backend in CLOUDS:
        raise InputError(f"backend: found {backend}, which runs the team's own software: give image and command")
    if not in_cloud and (settings.run_name is not None or settings.resume):
        raise InputError(
            f"{'run-name' if settings.run_name is not None else 'resume'}: is for the backend {CLOUDS_TEXT}"
        )
    if in_cloud and settings.registry_username is not None:
        raise InputError(f"registry-username: {backend} pulls with its execution role; push the image to ECR")
    return execution_target(
        backend if in_cloud else DOCKER,
        settings.aws_batch,
        settings.output,
        settings.run_name,
        settings.resume,
        runner,
        configuration.sections if configuration else None,
    )


def pull(settings: MatrixSettings, runner: Runner) -> None:
    """Pull the image if a login for it is given; the backend then finds it on the engine."""
    if settings.registry_username is None and settings.password_variable in (None, PASSWORD_VARIABLE):
        return  # the variable may be set for other commands
    if settings.registry_username is None or settings.password_variable is None:
        missing = "registry-username" if settings.registry_username is None else "registry-password"
        raise InputError(f"{missing} is not given: user and password go together")
    if (image := settings.software.get("image")) is None:
        raise InputError("registry-username is given without the image that it is for")

    login = RegistrySettings(username=settings.registry_username, password_variable=settings.password_variable)
    from calibration.ci.image.plan import pull_image  # imports the engine's SDK

    pull_image(image, login, runner, COMMAND_NAME)


def matrix_of(settings: MatrixSettings, configuration: "PipelineConfiguration | None") -> Matrix:
    """Return the matrix of calibrations: the configuration's or the single dataset's; the settings take precedence.

    Raises:
        InputError: a selected system is missing, or the settings are wrong.
    """
    known = configuration.systems if configuration else (_single_system(settings),)
    systems = tuple(_with_options(system, settings) for system in chosen_systems(known, settings.systems))
    return Matrix(systems, settings.noise.grid(configuration.noise if configuration else NoiseGrid()))


def configuration_of(settings: MatrixSettings) -> "PipelineConfiguration | None":
    """Read the configuration; None for a single dataset.

    Raises:
        InputError: both or none are given, or the configuration is wrong.
    """
    if (settings.dataset is None) == (settings.config is None):
        raise InputError("exactly one of dataset and config is to be given: a dataset's folder, or a calibration.yml")
    if settings.config is None:
        return None
    from calibration.pipeline.configuration import read_configuration  # with the rooms of all its sections

    return read_configuration(settings.config)


def _single_system(settings: MatrixSettings) -> System:
    """Return the system of a single dataset, named as its folder."""
    assert settings.dataset is not None  # noqa: S101 (else there is a configuration)
    folder = settings.dataset.resolve()
    return System(folder.parent.name if folder.suffix == ".json" else folder.name, settings.dataset)


def _with_options(system: System, settings: MatrixSettings) -> System:
    """Return a system with the keys given as options replaced."""
    system = changed(system, settings.of_systems, "options")
    if settings.rules is not None:
        system = replace(system, rules=read_rules(settings.rules))
    if settings.software:
        system = replace(system, software=adjusted_software(system.software, settings.software, Path.cwd()))
    return system
