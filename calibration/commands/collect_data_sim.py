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
    backend: str = "embedded"
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
@click.option("--backend", type=text, help="What simulates: embedded (embedded).")
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

    check_backend(settings.backend)
    worlds = [asked for asked in (settings.scenarios, settings.scenario) if asked is not None]
    if settings.scenario_set is None and worlds:
        raise InputError("scenarios and scenario need a scenario-set: a YAML file of what varies between worlds")
    if settings.scenario_set is not None and len(worlds) != 1:
        raise InputError("scenario-set: give either scenarios (how many worlds) or scenario (the id of one) with it")
    if settings.scenarios is not None:
        return _many_worlds(settings, runner)
    return _one_world(settings, runner)


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
    from calibration.pipeline.collection.results import CollectionChecks
    from calibration.simulation.collection.checks import Requirements

    def given(**values: Any) -> dict[str, Any]:
        return {name: value for name, value in values.items() if value is not None}

    stillness = None if settings.stillness_mm is None else settings.stillness_mm / 1000
    return CollectionRequest(
        system=system_folder(settings.system),
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        requirements=Requirements(**given(stillness=stillness)),
        checks=CollectionChecks(
            **given(
                minimum_collections=settings.minimum_collections,
                minimum_detection_rate=settings.minimum_detection_rate,
                minimum_coverage=settings.minimum_coverage,
                max_translation_mm=settings.max_translation_mm,
                max_rotation_deg=settings.max_rotation_deg,
            )
        ),
    )


def system_folder(system: str) -> Path:
    """The folder of a system, by its name in `SYSTEMS` or by its path.

    Raises:
        InputError: there is none.
    """
    for folder in (SYSTEMS / system, Path(system)):
        if system and folder.is_dir():
            return folder
    known = sorted(folder.parent.name for folder in SYSTEMS.glob("*/simulation.yml"))
    names = f"one of {', '.join(known)} or a folder" if known else "a folder"
    raise InputError(f"system: found '{system}', expected {names}")
