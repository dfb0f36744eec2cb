"""The options of ``collect-data-sim``, and the requests that are made of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from calibration.commands.parameters import find_system, system_folder
from calibration.commands.record_options import given
from calibration.errors import InputError
from calibration.execution.sizes import parse_seconds
from calibration.pipeline.collection.applications import SECONDS
from calibration.pipeline.collection.request import CollectionRequest, ContainerRequest, WorldImage, WorldOfSet
from calibration.pipeline.collection.results import CollectionChecks
from calibration.pipeline.configuration import parse_applications
from calibration.records import read
from calibration.simulation.scenarios.scenario import parse_id
from calibration.yaml_file import read_yaml


@dataclass(frozen=True)
class Settings:
    """The options of ``collect-data-sim``."""

    system: str
    """The name of a system in `SYSTEMS`, or a folder."""
    output: Path
    robot: Path | None = None
    config: Path | None = None
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    scenarios: int | None = None
    """How many worlds of the scenario set; None for the one that the system's files describe."""
    scenario_set: Path | None = None
    scenario: str | None = None
    """The id of one world of the scenario set, to collect it alone."""
    minimum_success_rate: float = 1.0
    seed: int = 1
    checks: CollectionChecks = field(default_factory=CollectionChecks)
    """What a dataset has to keep to, where the two limits that follow say nothing else."""
    max_translation_mm: float | None = None
    max_rotation_deg: float | None = None
    stillness_mm: float | None = None
    backend: str | None = None
    """None for docker where there are applications, else embedded."""
    aws_batch: Path | None = None
    """The file with the section aws-batch; calibration.yml where None."""
    run: str | None = None
    """The name of the run, for those who look for what it left."""
    resume: bool = False
    """Whether only what is missing of an earlier run is run."""
    applications: Path | None = None
    """What an entry ``simulation`` of calibration.yml says of containers, in a file of its own."""
    image: str | None = None
    """Of applications that name none; or, with a scenario set, of the worlds: it has calibration-ci."""
    simulation_command: str | None = None
    robot_command: str | None = None
    player: str | None = None
    ros: str | None = None
    truth: str | None = None
    timeout: str | None = None
    jobs: int | None = None
    overwrite: bool = False

    @classmethod
    def of_options(cls, options: Mapping[str, Any]) -> "Settings":
        """The settings that the options of the command make."""
        own = {each.name: value for each in fields(cls) if (value := options.get(each.name)) is not None}
        return cls(**own, checks=read(CollectionChecks, given(CollectionChecks, options), "options"))


def collection_request(settings: Settings) -> CollectionRequest:
    """The collection by our own simulation.

    Raises:
        InputError: there is no such system.
    """
    world = None
    if settings.scenario_set is not None and settings.scenario is not None:
        world = WorldOfSet(settings.scenario_set, settings.scenario)
    return CollectionRequest(
        system=system_folder(settings.system),
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        stillness=None if settings.stillness_mm is None else settings.stillness_mm / 1000,
        checks=collection_checks(settings),
        world=world,
    )


def application_request(settings: Settings, entry: dict[str, Any]) -> ContainerRequest:
    """The collection by the team's applications.

    Args:
        settings: of the command.
        entry: what they say of applications (`applications_entry`), not empty.

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


def applications_entry(settings: Settings) -> dict[str, Any]:
    """What the settings say of applications, as an entry ``simulation`` of calibration.yml; nothing where they do not.

    Raises:
        InputError: the file of the applications is wrong.
    """
    commands = {"simulation": settings.simulation_command, "robot": settings.robot_command}
    containers: dict[str, Any] = {
        name: {"command": command} for name, command in commands.items() if command is not None
    }
    if settings.applications is not None and containers:
        raise InputError("applications: excludes simulation-command and robot-command, which a file says itself")
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


def application_options(settings: Settings) -> tuple[str, ...]:
    """The options that say what the applications are, for the command that collects one dataset again."""
    names = ("applications", "image", "simulation_command", "robot_command", "player", "ros", "truth", "timeout")
    given = [(name.replace("_", "-"), getattr(settings, name)) for name in names]
    return tuple(word for name, value in given if value is not None for word in (f"--{name}", str(value)))


def world_image(settings: Settings, backend: str) -> WorldImage:
    """The image of worlds of our own simulation.

    Raises:
        InputError: there is none, or the time is none.
    """
    if settings.image is None:
        raise InputError(f"image: missing: {backend} runs every world in an image that has calibration-ci")
    return WorldImage(
        settings.image, SECONDS if settings.timeout is None else parse_seconds(settings.timeout, "timeout")
    )


def collection_checks(settings: Settings) -> CollectionChecks:
    """What a dataset has to keep to."""
    limits = {name: getattr(settings, name) for name in ("max_translation_mm", "max_rotation_deg")}
    return replace(settings.checks, **{name: limit for name, limit in limits.items() if limit is not None})
