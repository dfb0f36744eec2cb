"""``collect-data-sim`` in containers: the team's applications, once or often, and worlds of our own simulation."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from calibration.commands.collection_settings import Settings, collection_checks
from calibration.commands.place import place
from calibration.commands.system_folder import find_system
from calibration.errors import InputError
from calibration.execution.backends import DOCKER, Place
from calibration.execution.sizes import parse_seconds
from calibration.pipeline.collection.application_worlds import run_application_worlds
from calibration.pipeline.collection.applications import SECONDS
from calibration.pipeline.collection.gathering_worlds import Gathering
from calibration.pipeline.collection.in_containers import ContainerRequest, collect_in_containers
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.collection.scenarios import ScenarioRequest, ScenarioResults
from calibration.pipeline.collection.worlds_in_containers import WorldImage, run_worlds_in_containers
from calibration.pipeline.configuration import parse_applications
from calibration.simulation.scenarios.result import ScenarioResult
from calibration.workflow import Runner
from calibration.workflow.streams import LogDisplay
from calibration.yaml_file import read_yaml

MOST_SHOWN = 16
"""Of more worlds on this machine's engine the containers' logs are left in files only."""


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


def application_request(settings: Settings, entry: dict[str, Any], seed: int) -> ContainerRequest:
    """What the applications are to collect.

    Args:
        settings: of the command.
        entry: what they say of applications (`applications_entry`), not empty.
        seed: of the collection.

    Raises:
        InputError: the description is wrong, or a container has no image.
    """
    where, folder = (settings.applications or "applications", Path())
    if settings.applications is not None:
        folder = settings.applications.parent
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
    )


def collect_once(
    settings: Settings, request: ContainerRequest, number: int, backend: str, runner: Runner
) -> CollectionResults:
    """Collect one dataset with the team's applications.

    Args:
        settings: of the command.
        request: what to collect.
        number: of the collection among those of the seed.
        backend: where.
        runner: where logs are shown.

    Raises:
        InputError: an input is wrong.
        WorldError: the backend cannot be reached, or a file not be written.
    """
    with replace(_place(settings, backend, runner), show=LogDisplay(runner)).open() as opened:
        return collect_in_containers(request, settings.output, opened, settings.overwrite, number)


def run_in_containers(
    settings: Settings,
    request: ScenarioRequest,
    backend: str,
    runner: Runner,
    begin: Callable[[str, int], None],
    done: Callable[[ScenarioResult], None],
) -> ScenarioResults:
    """Run worlds of our own simulation, or the team's applications often.

    Args:
        settings: of the command.
        request: which worlds.
        backend: where.
        runner: where logs are shown.
        begin: called when everything was read and checked.
        done: called after each world.

    Raises:
        InputError: an input is wrong.
        WorldError: the backend cannot be reached, or a file not be written.
    """
    show = LogDisplay(runner) if backend != DOCKER or request.count <= MOST_SHOWN else None
    with replace(_place(settings, backend, runner), show=show).open() as opened:
        gathering = Gathering(opened, settings.output, settings.jobs, settings.resume, settings.overwrite)
        if request.applications:
            return run_application_worlds(request, gathering, begin, done)
        assert settings.image is not None  # noqa: S101 (checked by the caller)
        seconds = SECONDS if settings.timeout is None else parse_seconds(settings.timeout, "timeout")
        return run_worlds_in_containers(request, WorldImage(settings.image, seconds), gathering, begin, done)


def application_options(settings: Settings) -> tuple[str, ...]:
    """The options that say what the applications are, for the command that collects one dataset again."""
    names = ("applications", "image", "simulation_command", "robot_command", "player", "ros", "truth", "timeout")
    given = [(name.replace("_", "-"), getattr(settings, name)) for name in names]
    return tuple(word for name, value in given if value is not None for word in (f"--{name}", str(value)))


def _place(settings: Settings, backend: str, runner: Runner) -> Place:
    """Where containers run.

    Raises:
        InputError: nothing says where in the cloud, or which run is to be resumed.
        WorldError: the name of the run cannot be kept.
    """
    return place(backend, settings.aws_batch, settings.output, settings.run, settings.resume, runner)
