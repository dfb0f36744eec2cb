"""Options of ``collect-data-sim``, and their conversion to requests."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from calibration.base.errors import InputError
from calibration.base.records import at_least, field, record
from calibration.base.yaml_file import read_yaml
from calibration.ci.execution.sizes import parse_seconds
from calibration.commands.parameters import find_system, system_folder
from calibration.pipeline.collection.applications import SECONDS
from calibration.pipeline.collection.request import (
    CollectionChecks,
    CollectionRequest,
    ContainerRequest,
    ScenarioImage,
    ScenarioOfSet,
    Share,
)
from calibration.pipeline.configuration import parse_applications
from calibration.robot.simulation.scenarios.scenario import parse_id

Tolerance = Annotated[float, at_least(0)]


@record(kw_only=True)
class CollectionSettings:
    """Inputs of ``collect-data-sim``."""

    system: str = field("Name of a system in datasets/, or the folder of one.")
    robot: Path | None = field("URDF or xacro, in place of the system's robot.urdf.", default=None)
    config: Path | None = field("ATOM's calibration configuration, in place of the system's config.yml.", default=None)
    motion: str | None = field(
        "Motion sequence (JSON), or generate:N; by default the system's motion.json.", default=None
    )
    scenarios: Annotated[int, at_least(1)] | None = field(
        "Number of scenarios of the set, or of datasets of the applications.", default=None
    )
    scenario_set: Path | None = field("YAML file of the parameters that vary between scenarios.", default=None)
    scenario: str | None = field("Only this scenario, with its images: s1-00017 (seed 1, number 17).", default=None)
    minimum_success_rate: Share = field("Share of the scenarios that must pass, 0 to 1 (1).", default=1.0)
    seed: Annotated[int, at_least(0)] = field(
        "Seed of the noise, of a generated motion, of the scenarios (1).", default=1
    )
    checks: CollectionChecks = field(flat=True, default_factory=CollectionChecks)
    """Limits of a dataset; the following two limits take precedence."""
    max_translation_mm: Tolerance | None = field("Largest error against the truth, mm (5).", default=None)
    max_rotation_deg: Tolerance | None = field("Largest error against the truth, degrees (0.3).", default=None)
    stillness_mm: Tolerance | None = field("Largest movement of the pattern during a collection, mm (2).", default=None)
    backend: str | None = field("embedded, or containers on docker or aws-batch.", default=None)
    aws_batch: Path | None = field("YAML file with the section aws-batch (calibration.yml).", default=None)
    run: str | None = field("Name of the run in containers or the cloud (a new one).", default=None)
    resume: bool = field("Run only what is missing of an earlier run into this folder, or of this name.", default=False)
    applications: Path | None = field("YAML file of the team's applications, each in a container.", default=None)
    image: str | None = field(
        "Default image of the applications; or image with calibration-ci for scenarios.", default=None
    )
    simulation_command: str | None = field(
        "Command of the simulation application, instead of a file of applications.", default=None
    )
    robot_command: str | None = field("Command of the robot application, which labels and saves.", default=None)
    player: Literal["ros1"] | None = field("ros1: our player moves the pattern and asks for collections.", default=None)
    ros: Literal["none", "1", "2"] | None = field("1 starts a ROS master beside the applications.", default=None)
    truth: str | None = field(
        "Ground truth of the applications' dataset: a file, dataset or none (the system's).", default=None
    )
    timeout: str | None = field(
        "Time limit of the applications, or of a scenario in a container: 10m (1h).", default=None
    )
    jobs: Annotated[int, at_least(1)] | None = field(
        "Number of parallel processes or containers (one per core).", default=None
    )
    output: Path = field("Folder for the dataset, or for the report on the scenarios.")
    overwrite: bool = field("Replace a dataset that the folder has.", default=False)


def collection_request(settings: CollectionSettings) -> CollectionRequest:
    """Return the request for a collection by our own simulation.

    Raises:
        InputError: the system does not exist.
    """
    scenario = None
    if settings.scenario_set is not None and settings.scenario is not None:
        scenario = ScenarioOfSet(settings.scenario_set, settings.scenario)
    return CollectionRequest(
        system=system_folder(settings.system),
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        stillness=None if settings.stillness_mm is None else settings.stillness_mm / 1000,
        checks=collection_checks(settings),
        scenario=scenario,
    )


def application_request(settings: CollectionSettings, entry: dict[str, Any]) -> ContainerRequest:
    """Return the request for a collection by the team's applications.

    Args:
        settings: settings of the command.
        entry: description of the applications (`applications_entry`), not empty.

    Raises:
        InputError: the description is wrong, or a container has no image.
    """
    where = settings.applications or "applications"
    folder = settings.applications.parent if settings.applications is not None else Path()
    applications = parse_applications(entry, folder, str(where))
    for container in applications.containers:
        if not container.image:
            raise InputError(f"{where}: containers.{container.name}: missing image (or give one for all)")
    system = find_system(settings.system)
    checks = collection_checks(settings)
    if settings.truth == "none":
        checks = replace(
            checks, max_translation_mm=settings.max_translation_mm, max_rotation_deg=settings.max_rotation_deg
        )
    seed, scenario = (settings.seed, 0) if settings.scenario is None else parse_id(settings.scenario)
    return ContainerRequest(
        name=system.name if system else settings.system,
        applications=applications,
        system=system,
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=seed,
        checks=checks,
        truth=settings.truth,
        scenario=scenario,
    )


def applications_entry(settings: CollectionSettings) -> dict[str, Any]:
    """Return the description of applications in the settings, as an entry ``simulation`` of calibration.yml, or empty.

    Raises:
        InputError: the file of the applications is wrong.
    """
    commands = {"simulation": settings.simulation_command, "robot": settings.robot_command}
    containers: dict[str, Any] = {
        name: {"command": command} for name, command in commands.items() if command is not None
    }
    if settings.applications is not None and containers:
        raise InputError("applications: excludes simulation-command and robot-command, which are part of the file")
    entry: dict[str, Any] = {"containers": containers} if containers else {}
    if "robot" in containers and "simulation" in containers:
        containers["robot"]["after"] = ["simulation"]
    if settings.applications is not None:
        document = read_yaml(settings.applications, "a description of applications")
        if not isinstance(document, dict) or "containers" not in document:
            raise InputError(f"{settings.applications}: expected a mapping with containers, as in calibration.yml")
        entry = document
    names = ("image", "player", "ros", "timeout")
    given = {name: value for name in names if (value := getattr(settings, name)) is not None}
    for name in ("player", "ros"):
        if name in given and not entry:
            raise InputError(f"{name}: needs applications, or simulation-command and robot-command")
    return {**entry, **given} if entry else {}


def application_options(settings: CollectionSettings) -> tuple[str, ...]:
    """Return the options of the applications, for the command that reproduces one dataset."""
    names = ("applications", "image", "simulation_command", "robot_command", "player", "ros", "truth", "timeout")
    given = [(name.replace("_", "-"), getattr(settings, name)) for name in names]
    return tuple(word for name, value in given if value is not None for word in (f"--{name}", str(value)))


def scenario_image(settings: CollectionSettings, backend: str) -> ScenarioImage:
    """Return the image of scenarios of our own simulation.

    Raises:
        InputError: the image is missing, or the time-out is invalid.
    """
    if settings.image is None:
        raise InputError(f"image: missing: {backend} runs every scenario in an image that has calibration-ci")
    return ScenarioImage(
        settings.image, SECONDS if settings.timeout is None else parse_seconds(settings.timeout, "timeout")
    )


def collection_checks(settings: CollectionSettings) -> CollectionChecks:
    """Return the limits of a dataset."""
    limits = {name: getattr(settings, name) for name in ("max_translation_mm", "max_rotation_deg")}
    return replace(settings.checks, **{name: limit for name, limit in limits.items() if limit is not None})
