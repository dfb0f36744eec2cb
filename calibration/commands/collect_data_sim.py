"""``collect-data-sim``: a system and a motion to a dataset, in simulation, proven by calibrating it."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from calibration.commands.parameters import boolean_option, count, non_negative, path, share, text
from calibration.errors import ExitCode, InputError
from calibration.workflow import Runner, stop_commands

if TYPE_CHECKING:
    from calibration.pipeline.collection.collecting import CollectionRequest
    from calibration.pipeline.collection.results import CollectionChecks
    from calibration.simulation.collection.record import Record
    from calibration.simulation.motion.sequence import Motion
    from calibration.simulation.scenarios.result import ScenarioResult
    from calibration.simulation.system import System

SYSTEMS = Path("datasets")
"""Where the name of a system is looked up, from the working directory."""
TITLE = "collect-data-sim"


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
    """What ``collect-data-sim`` is asked; what is None is as `CollectionChecks` and `Requirements` say."""

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
    minimum_collections: int | None = None
    minimum_detection_rate: float | None = None
    minimum_coverage: float | None = None
    max_translation_mm: float | None = None
    max_rotation_deg: float | None = None
    stillness_mm: float | None = None
    backend: str | None = None
    """None for docker where there are applications, else embedded."""
    applications: Path | None = None
    """What an entry ``simulation`` of calibration.yml says of containers, in a file of its own."""
    image: str | None = None
    simulation_command: str | None = None
    robot_command: str | None = None
    player: str | None = None
    ros: str | None = None
    truth: str | None = None
    timeout: str | None = None
    jobs: int | None = None
    overwrite: bool = False


@click.command("collect-data-sim")
@click.option("--system", type=text, required=True, help="Name of a system in datasets/, or the folder of one.")
@click.option("--robot", type=path, help="URDF file, in place of the system's robot.urdf.")
@click.option("--config", type=path, help="ATOM's calibration configuration, in place of the system's config.yml.")
@click.option(
    "--motion", type=text, help="Motion sequence (JSON), or generate:N; the system's motion.json unless given."
)
@click.option("--scenarios", type=count, help="How many worlds of the scenario set are collected and calibrated.")
@click.option("--scenario-set", type=path, help="YAML file of what varies between worlds.")
@click.option("--scenario", type=text, help="Only this world of the scenario set, with its images: s1-00017.")
@click.option("--minimum-success-rate", type=share, help="Share of the worlds that has to pass, 0 to 1 (1).")
@click.option("--seed", type=seed_number, help="Seed of the noise, of a generated motion, of the worlds (1).")
@click.option("--minimum-collections", type=count, help="Fewer collections that are kept make it fail (3).")
@click.option("--minimum-detection-rate", type=share, help="Share of the poses that every sensor detects, 0 to 1.")
@click.option("--minimum-coverage", type=share, help="Share of every image that the corners cover, 0 to 1.")
@click.option("--max-translation-mm", type=non_negative, help="Largest error against the truth, mm (5).")
@click.option("--max-rotation-deg", type=non_negative, help="Largest error against the truth, degrees (0.3).")
@click.option("--stillness-mm", type=non_negative, help="How far the pattern may move while the sensors look (2).")
@click.option("--backend", type=text, help="What simulates: embedded, or docker for the team's own applications.")
@click.option("--applications", type=path, help="YAML file of the team's applications, each in a container.")
@click.option("--image", type=text, help="The image of applications that name none.")
@click.option("--simulation-command", type=text, help="What the simulation application runs, without a file for it.")
@click.option("--robot-command", type=text, help="What the robot application runs, which labels and saves.")
@click.option(
    "--player", type=click.Choice(["ros1"]), help="ros1: our player moves the pattern and asks for collections."
)
@click.option("--ros", type=click.Choice(["none", "1", "2"]), help="1 starts a ROS master beside the applications.")
@click.option("--truth", type=text, help="Of the applications' dataset: a file, dataset or none (the system's).")
@click.option("--timeout", type=text, help="How long the applications may take, such as 10m (1h).")
@click.option("--jobs", type=count, help="Processes (one a core).")
@click.option(
    "--output",
    type=path,
    required=True,
    help="Folder for the dataset, or for the report on the worlds.",
)
@boolean_option("--overwrite", help="Replace a dataset that the folder has.")
def command(**options: Any) -> ExitCode:
    """Collect a dataset in simulation: images, point clouds, labels and the truth; and calibrate it."""
    settings = Settings(**{name: value for name, value in options.items() if value is not None})
    return collect_data_sim(settings, Runner.from_environment(os.environ))


def collect_data_sim(settings: Settings, runner: Runner) -> ExitCode:
    """Collect a dataset, calibrate it, and report both; or do so in many worlds.

    Raises:
        InputError: an input is missing or wrong, or the folder has a dataset already.
        WorldError: the folder cannot be written, or a process died; its dataset is as before.
    """
    from calibration.execution.backends import check_backend

    applications = _applications_entry(settings)
    backend = settings.backend or ("docker" if applications else "embedded")
    check_backend(backend)
    if (backend == "docker") != bool(applications):
        raise InputError(
            f"backend: found {backend}; docker runs the team's applications (applications, or image with "
            "simulation-command and robot-command), embedded our own simulation"
        )
    if applications:
        return _in_containers(settings, applications, runner)
    worlds = [asked for asked in (settings.scenarios, settings.scenario) if asked is not None]
    if settings.scenario_set is None and worlds:
        raise InputError("scenarios and scenario need a scenario-set: a YAML file of what varies between worlds")
    if settings.scenario_set is not None and len(worlds) != 1:
        raise InputError("scenario-set: give either scenarios (how many worlds) or scenario (the id of one) with it")
    if settings.scenarios is not None:
        return _many_worlds(settings, runner)
    return _one_world(settings, runner)


def _applications_entry(settings: Settings) -> dict[str, Any]:
    """What the settings say of applications, as an entry ``simulation`` of calibration.yml; nothing where they do not.

    Raises:
        InputError: the file of the applications is wrong.
    """
    from calibration.yaml_file import read_yaml

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
    if given and not entry:
        raise InputError(f"{next(iter(given))}: needs applications, or simulation-command and robot-command")
    return {**entry, **given} if entry else {}


def _in_containers(settings: Settings, entry: dict[str, Any], runner: Runner) -> ExitCode:
    from dataclasses import replace

    from calibration.execution.backends import docker_backend
    from calibration.pipeline.collection.in_containers import ContainerRequest, collect_in_containers
    from calibration.pipeline.collection.report import report_collection
    from calibration.pipeline.configuration import parse_applications
    from calibration.workflow.streams import LogDisplay

    if settings.scenario_set is not None:
        raise InputError("scenario-set: worlds vary in our own simulation only, not in applications")
    where, folder = (settings.applications or "applications", Path())
    if settings.applications is not None:
        folder = settings.applications.parent
    applications = parse_applications(entry, folder, str(where))
    for container in applications.containers:
        if not container.image:
            raise InputError(f"{where}: containers.{container.name}: missing image (or give one for all)")
    system = find_system(settings.system)
    checks = _checks(settings)
    if settings.truth == "none":
        checks = replace(
            checks, max_translation_mm=settings.max_translation_mm, max_rotation_deg=settings.max_rotation_deg
        )
    request = ContainerRequest(
        name=system.name if system else settings.system,
        applications=applications,
        system=system,
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        checks=checks,
        truth=settings.truth,
    )
    with docker_backend(LogDisplay(runner)) as backend:
        results = collect_in_containers(request, settings.output, backend, settings.overwrite)
    report_collection(results, settings.output, runner, TITLE)
    return results.exit_code


def _one_world(settings: Settings, runner: Runner) -> ExitCode:
    from calibration.pipeline.collection.collecting import collect_dataset
    from calibration.pipeline.collection.report import pose_line, report_collection
    from calibration.pipeline.collection.scenarios import collect_world
    from calibration.workflow.progress import progress

    request = _request(settings)

    def begin(system: "System", motion: "Motion") -> None:
        world = "" if settings.scenario is None else f" in world {settings.scenario}"
        runner.log(f"{system.name}{world}: {len(motion)} poses of {motion.source}, seed {request.seed}")

    finished = 0
    try:
        with stop_commands(runner), progress(runner, TITLE) as advance:  # names in files that others wrote

            def done(count: int, total: int, record: "Record") -> None:
                nonlocal finished
                finished = count
                advance(count, total, pose_line(record), important=not record.kept)

            to = (settings.output, settings.overwrite, settings.jobs, begin, done)
            if settings.scenario is not None and settings.scenario_set is not None:
                results = collect_world(request, settings.scenario_set, settings.scenario, *to)
            else:
                results = collect_dataset(request, *to)
    except BaseException:
        if finished:
            runner.log(f"{finished} poses are done: the same command goes on from there")
        raise
    report_collection(results, settings.output, runner, TITLE)
    return results.exit_code


def _many_worlds(settings: Settings, runner: Runner) -> ExitCode:
    from calibration.pipeline.collection.scenario_report import report_scenarios, world_line
    from calibration.pipeline.collection.scenarios import MAX_SCENARIOS, ScenarioRequest, run_worlds
    from calibration.workflow.progress import progress

    if settings.scenarios is None or settings.scenario_set is None:
        raise AssertionError("collect_data_sim has checked both")
    if settings.scenarios > MAX_SCENARIOS:
        raise InputError(f"scenarios: found {settings.scenarios}, expected {MAX_SCENARIOS} at most")
    request = ScenarioRequest(
        _request(settings), settings.scenario_set, settings.scenarios, settings.minimum_success_rate
    )

    def begin(system: str, worlds: int) -> None:
        runner.log(f"{system}: {worlds} worlds of {settings.scenario_set}, seed {settings.seed}")

    with stop_commands(runner), progress(runner, TITLE) as advance:
        finished = 0

        def done(result: "ScenarioResult") -> None:
            nonlocal finished
            finished += 1
            advance(finished, request.count, world_line(result), important=not result.converged)

        results = run_worlds(request, settings.output, settings.jobs, begin, done)
    report_scenarios(results, settings.output, runner, TITLE)
    return results.exit_code


def _request(settings: Settings) -> "CollectionRequest":
    from calibration.pipeline.collection.collecting import CollectionRequest
    from calibration.simulation.collection.checks import Requirements

    stillness = None if settings.stillness_mm is None else settings.stillness_mm / 1000
    return CollectionRequest(
        system=system_folder(settings.system),
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        requirements=Requirements(**_given(stillness=stillness)),
        checks=_checks(settings),
    )


def _checks(settings: Settings) -> "CollectionChecks":
    from calibration.pipeline.collection.results import CollectionChecks

    names = (
        *("minimum_collections", "minimum_detection_rate", "minimum_coverage"),
        *("max_translation_mm", "max_rotation_deg"),
    )
    return CollectionChecks(**_given(**{name: getattr(settings, name) for name in names}))


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def find_system(system: str) -> Path | None:
    """The folder of a system, by its name in `SYSTEMS` or by its path; None where there is none."""
    return next((folder for folder in (SYSTEMS / system, Path(system)) if system and folder.is_dir()), None)


def system_folder(system: str) -> Path:
    """The folder of a system, as `find_system` finds it.

    Raises:
        InputError: there is none.
    """
    if (folder := find_system(system)) is not None:
        return folder
    known = sorted(folder.parent.name for folder in SYSTEMS.glob("*/simulation.yml"))
    names = f"one of {', '.join(known)} or a folder" if known else "a folder"
    raise InputError(f"system: found '{system}', expected {names}")
