"""``fleet``: compare the accepted calibrations of all robots of a repository that has a folder for each."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
import numpy as np

from calibration.addons.delivery.changes import read_contents
from calibration.addons.delivery.checking import SECONDS_OF_DAY
from calibration.addons.delivery.destinations import DeliveryFolder, FetchedBundle, fetch_bundle
from calibration.base import CalibrationError, ExitCode, InputError
from calibration.base.records import field, record, result
from calibration.ci.execution.job import Seconds
from calibration.ci.git import Repository
from calibration.ci.pages.charts import heat_map
from calibration.ci.pages.html import Html, bullets, figure, page, section, verdict_line
from calibration.ci.pages.html import table as html_table
from calibration.ci.report import Outcome, Report, Table, count_of, publish, verdict_of
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.baseline.comparison import MIN_ROBOTS, MountOfFleet, MountOfRobot, compare, compare_fleet
from calibration.engine.baseline.document import read_baseline
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds, size_of_change
from calibration.pipeline.configuration import DEFAULT_FILE

TITLE, PAGE_FILE = "fleet", "fleet.html"
ROBOT_IN_NAME = "{robot}"


@record(kw_only=True)
class FleetSettings:
    """Inputs of ``fleet``."""

    baseline: Path = field(
        "File of the accepted calibrations in each robot's folder (calibration-baseline.json).",
        default=Path("calibration-baseline.json"),
    )
    max_age: Seconds | None = field("Largest time since a robot's calibration was accepted: 180d.", default=None)
    delivered: str | None = field(
        "What was delivered, with {robot} for the name of a robot's folder: ghcr.io/team/{robot}, or a path.",
        default=None,
    )
    output: Path = field("Folder for results and page.", default=Path("output/fleet"))


@result(kw_only=True)
class RobotOfFleet:
    """One robot of a fleet."""

    name: str = field("Name of its folder.")
    accepted: str | None = field("Date of the last commit of its accepted calibrations.", default=None)
    age_days: float | None = field("Time since then.", unit="days", default=None)
    delivered: str | None = field("Version that was delivered.", default=None)
    reasons: tuple[str, ...] = field("No calibration, an old one, another than was delivered, or an outlier.")


@result(kw_only=True)
class FleetResults:
    """Results of fleet."""

    robots: tuple[RobotOfFleet, ...] = field("The robots, by name.")
    mounts: tuple[MountOfFleet, ...] = field("What enough robots have to be compared.")
    not_compared: tuple[str, ...] = field("Mounts that too few robots have.", default=())


@dataclass(frozen=True)
class AcceptedRobot:
    """A robot with its accepted calibrations, by system."""

    found: RobotOfFleet
    systems: Mapping[str, CalibrationDocument]


@click.command(TITLE)
@click.argument("folder", type=Path)
@record_options(FleetSettings)
def command(folder: Path, **options: Any) -> ExitCode:
    """Compare the accepted calibrations of all robots that have a folder in FOLDER. Exit code 1 if one stands out.

    A robot stands out if a mount is not like those of the others, or its calibration is missing, old or not what was
    delivered.
    """
    runner = Runner.from_environment()
    settings = chosen(FleetSettings, options)
    found = compare_robots([*_accepted_robots(folder, settings, runner)])
    return publish(_report(found), runner, settings.output)


def compare_robots(robots: list[AcceptedRobot]) -> FleetResults:
    """Return the comparison of robots by their mounts, with the outliers among the robots' reasons."""
    poses: dict[str, dict[str, CalibratedPose]] = {}
    for robot in robots:
        for system, calibration in robot.systems.items():
            for pose in calibration.poses:
                poses.setdefault(f"{system}: {pose.name}", {})[robot.found.name] = pose
    mounts = compare_fleet(poses)
    outliers = [each for mount in mounts for each in mount.robots if each.outlier]
    return FleetResults(
        robots=tuple(_with_outliers(robot.found, outliers) for robot in robots),
        mounts=mounts,
        not_compared=tuple(
            f"{name}: {count_of(len(each), 'robot')} with it, expected at least {MIN_ROBOTS} to be compared"
            for name, each in poses.items()
            if len(each) < MIN_ROBOTS
        ),
    )


def _with_outliers(robot: RobotOfFleet, outliers: list[MountOfRobot]) -> RobotOfFleet:
    reasons = [f"{each.name} is not like the fleet's: {_size(each)}" for each in outliers if each.robot == robot.name]
    return replace(robot, reasons=(*robot.reasons, *reasons))


def _size(of: MountOfRobot) -> str:
    return (
        f"{of.mm:.3g} ± {of.sigma_mm:.2g} mm, {of.deg:.3g} ± {of.sigma_deg:.2g} deg from the median; "
        f"{of.sigmas_translation:.2g} and {of.sigmas_rotation:.2g} standard deviations of the others"
    )


def _accepted_robots(folder: Path, settings: FleetSettings, runner: Runner) -> Iterator[AcceptedRobot]:
    """Yield the robots: the folders with a configuration or accepted calibrations.

    Raises:
        InputError: there are none.
    """
    if settings.delivered is not None and ROBOT_IN_NAME not in settings.delivered:
        raise InputError(f"--delivered: found {settings.delivered!r}, expected {ROBOT_IN_NAME} in it")
    folders = sorted(each for each in folder.iterdir() if each.is_dir()) if folder.is_dir() else []
    robots = [each for each in folders if (each / DEFAULT_FILE).exists() or (each / settings.baseline).exists()]
    if not robots:
        raise InputError(f"{folder}: found no folder with {DEFAULT_FILE} or {settings.baseline}, expected one a robot")
    for robot in robots:
        yield _accepted_robot(robot, settings, runner)


def _accepted_robot(folder: Path, settings: FleetSettings, runner: Runner) -> AcceptedRobot:
    try:
        baseline = read_baseline(folder / settings.baseline)
    except InputError as error:
        return AcceptedRobot(RobotOfFleet(name=folder.name, reasons=(str(error),)), {})
    if baseline is None or not baseline.systems:
        return AcceptedRobot(RobotOfFleet(name=folder.name, reasons=("no calibration of it is accepted",)), {})
    reasons = []
    accepted = _time_of_commit(folder / settings.baseline)
    age = None if accepted is None else time.time() - accepted.timestamp()
    if settings.max_age is not None and (age is None or age > settings.max_age):
        what = "is in no commit" if age is None else f"is {age / SECONDS_OF_DAY:.0f} days old"
        reasons.append(f"its calibration {what}, expected at most {settings.max_age / SECONDS_OF_DAY:g} days")
    version = None
    if settings.delivered is not None:
        version, differences = _against_delivered(
            settings.delivered.replace(ROBOT_IN_NAME, folder.name), baseline.systems, runner
        )
        reasons += differences
    found = RobotOfFleet(
        name=folder.name,
        accepted=None if accepted is None else accepted.date().isoformat(),
        age_days=None if age is None else round(age / SECONDS_OF_DAY, 1),
        delivered=version,
        reasons=tuple(reasons),
    )
    return AcceptedRobot(found, baseline.systems)


def _time_of_commit(file: Path) -> datetime | None:
    """Return the time of the last commit of a file; None if it is in none."""
    try:
        repository = Repository.around(file.resolve().parent)
        path = repository.path(file)
        commits = repository.changes_of(path, newest=1) if path else []
    except CalibrationError:
        return None
    seconds = repository.commit_time(commits[0].hash) if commits else None
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)


def _against_delivered(
    text: str, systems: Mapping[str, CalibrationDocument], runner: Runner
) -> tuple[str | None, list[str]]:
    """Return the version that was delivered, and by what accepted calibrations differ from it.

    Raises:
        InfrastructureError: a registry does not answer.
    """
    try:
        contents = read_contents(_delivered_bundle(text, runner))
    except InputError as error:
        return None, [f"nothing was delivered: {error}"]
    version, reasons = contents.manifest.version, []
    for name, accepted in systems.items():
        delivered = contents.calibrations.get(name)
        if delivered is None:
            reasons.append(f"{name} is not in {version}, which was delivered")
            continue
        found = compare(delivered, accepted)
        moved = [each for each in found.changes if not found.same_data or exceeds(each, SameData())]
        if moved:
            worst = max(moved, key=lambda each: each.mm)
            size = worst.kind if worst.kind in ("added", "removed") else size_of_change(worst)
            reasons.append(f"{version}, which was delivered, is another calibration: {name}: {worst.name}: {size}")
    return version, reasons


def _delivered_bundle(text: str, runner: Runner) -> FetchedBundle:
    """Return the last bundle in a folder of versions, or else a bundle wherever it is."""
    last = DeliveryFolder(Path(text), runner).last()
    return fetch_bundle(text, None, runner, offline=False) if last is None else last


def _report(found: FleetResults) -> Report:
    reasons = tuple(f"{robot.name}: {reason}" for robot in found.robots for reason in robot.reasons)
    outstanding = sum(1 for robot in found.robots if robot.reasons)
    tables = (
        Table(("Robot", "Accepted", "Delivered", "Stands out"), tuple(_rows_of_robots(found)), title="Robots"),
        Table(("Mount", "Robots", "Spread", "Error bar"), tuple(_rows_of_mounts(found)), title="Spread of the fleet"),
    )
    sentence = f"{outstanding} of {count_of(len(found.robots), 'robot')} stand out"
    verdict = verdict_of(not reasons)
    sections = [
        section("Fleet", verdict_line(verdict, sentence), bullets((*reasons, *found.not_compared)), _figure(found)),
        *(section(each.title, html_table(each.columns, each.rows)) for each in tables),
    ]
    return Report(
        title="Fleet",
        verdict=verdict,
        sentence=sentence,
        reasons=reasons,
        warnings=found.not_compared,
        results=found,
        blocks=tables,
        suites={TITLE: [Outcome(name=robot.name, reasons=robot.reasons) for robot in found.robots]},
        outputs={"outliers": [each.name for each in found.robots if each.reasons]},
        files={PAGE_FILE: page("Fleet", sections)},
    )


def _rows_of_robots(found: FleetResults) -> Iterator[tuple[str, ...]]:
    for robot in found.robots:
        age = "" if robot.age_days is None else f", {count_of(round(robot.age_days), 'day')}"
        yield robot.name, f"{robot.accepted or '-'}{age}", robot.delivered or "-", "; ".join(robot.reasons) or "-"


def _rows_of_mounts(found: FleetResults) -> Iterator[tuple[str, ...]]:
    for mount in found.mounts:
        mm, deg = (
            float(np.median([getattr(each, name) for each in mount.robots])) for name in ("sigma_mm", "sigma_deg")
        )
        spread = f"{mount.fleet_sigma_mm:.3g} mm, {mount.fleet_sigma_deg:.2g} deg"
        yield mount.name, str(len(mount.robots)), spread, f"{mm:.2g} mm, {deg:.2g} deg"


def _figure(found: FleetResults) -> Html:
    """Return the map of all mounts and robots: how many standard deviations each is from the others."""
    if not found.mounts:
        return Html("")
    names = [robot.name for robot in found.robots]
    values = np.full((2 * len(found.mounts), len(names)), np.nan)
    for i, mount in enumerate(found.mounts):
        for each in mount.robots:
            values[2 * i : 2 * i + 2, names.index(each.robot)] = each.sigmas_translation, each.sigmas_rotation
    rows = [f"{mount.name}, {unit}" for mount in found.mounts for unit in ("mm", "deg")]
    title, unit = "From the others of the fleet", "standard deviations"
    drawn = heat_map(title, rows, names, values, unit, "robot")
    return figure(drawn, f"Each mount from the mean of the other robots' in {unit}, its error bar among them.")
