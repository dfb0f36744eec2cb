"""Systems to calibrate, and their initial guesses: shared by the stages and the configuration."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from calibration.base import InputError, did_you_mean, records
from calibration.base.records import field, record
from calibration.base.tables.rules import RuleEntry, RuleSet, checked, unfolded
from calibration.engine.baseline.verdict import Accepted
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import Options
from calibration.engine.tasks.robot_task import RobotTask
from calibration.pipeline.containers import Software, Text, checked_software
from calibration.robot.exports import FORMATS, URDF
from calibration.robot.robot_description import XacroInputs

FormatName = Annotated[str, records.matching("|".join((URDF, *FORMATS)), f"one of {', '.join((URDF, *FORMATS))}")]
COLLECTED_PREFIX = "simulation:"
"""Prefix of a system's dataset that an entry of ``simulation`` collects."""


def _dataset_path(text: str, place: records.Place) -> Path:
    return Path(text) if text.startswith(COLLECTED_PREFIX) else place.folder / text


def _truth_path(text: str, place: records.Place) -> str:
    return text if text in ("dataset", "none") else str(place.folder / text)


def _rules_from(found: RuleSet | tuple[RuleEntry, ...], place: records.Place) -> RuleSet:
    return checked(RuleSet(unfolded(found)) if isinstance(found, tuple) else found, str(place))


Undecided = Literal["fail", "pass"]
Datasets = Literal["full", "changes", "none"]
Copies = Literal["leave-out", "refuse"]
"""What happens to collections that are exact copies of others."""
Truth = Annotated[str, records.Converted(Text, _truth_path)]
"""A path, "dataset" or "none"."""


@record
class Exports:
    """Exports of a system that passes, in the folder ``exports`` of its first cell that passed."""

    formats: Annotated[tuple[FormatName, ...], records.UNIQUE] = field(
        f"The formats: {', '.join((URDF, *FORMATS))}; by default all that there can be.", default=()
    )
    robot_description: Path | None = field("The robot's URDF or xacro, relative to this file.", default=None)
    xacro: XacroInputs = field(flat=True, default_factory=XacroInputs)

    def __post_init__(self) -> None:
        """Refuse a URDF export without a robot description.

        Raises:
            Misfit: it is missing.
        """
        if URDF in self.formats and self.robot_description is None:
            raise records.Misfit(f"{URDF} needs robot-description, the robot's own URDF", "formats")


@record
class System:
    """Robot to calibrate."""

    name: str
    dataset: Annotated[Path, records.Converted(Text, _dataset_path)] = field(
        "A folder with dataset.json, or the file, relative to this one; simulation:NAME for what that entry of "
        "simulation collects in this run.",
        option=False,
    )
    evaluate: Text | None = field(
        "The table: rgb-to-rgb:SOURCE:TARGET, lidar-to-rgb:LIDAR:CAMERA, depth-to-rgb:DEPTH:CAMERA, "
        "lidar-to-lidar:SOURCE:TARGET, lidar-to-depth:LIDAR:DEPTH or depth-to-depth:SOURCE:TARGET, each also as "
        "inter-collection-...; single-rgb, measured-poses:SENSOR, ground-truth-transform:PARENT:CHILD or "
        "ground-truth-frame:FRAME. ':PATTERN' may follow two sensors.",
        default=None,
        option="The table: rgb-to-rgb:SOURCE:TARGET, lidar-to-rgb:LIDAR:CAMERA, ...",
    )
    """Text of `specification.parse_evaluation`; None for the table of reprojection errors."""
    truth: Truth | None = field(
        "What the result is compared with: a file, 'dataset' for the transforms in it, 'none'. By default "
        "ground_truth.json beside the dataset, where there is one.",
        default=None,
        option="ground_truth.json's path, dataset or none (the file beside the dataset).",
    )
    compare: Annotated[tuple[Text, ...], records.UNIQUE] = field(
        "Other methods on the same data, as rows of the same table: opencv-stereo, opencv-stereo-fixed, shah, li, "
        "tsai, park, horaud, andreff, daniilidis, icp, icp-average, icp-best.",
        default=(),
        option="Other methods on the same data: opencv-stereo, shah, tsai, icp, ...",
    )
    rules: Annotated[RuleSet, records.Converted(RuleSet | tuple[RuleEntry, ...], _rules_from)] | None = field(
        "Rules over the table of every cell, as introspect-csv takes them.",
        default=None,
        option=False,
    )
    options: Options = field(flat=True, default_factory=Options)
    limits: Limits = field("The largest values that pass, in every cell.", default_factory=Limits, option=False)
    tasks: Annotated[tuple[RobotTask, ...], records.ByName()] = field(
        "What the robot does with its calibration, by name: its error there, and a limit of that. With such limits, "
        "those of sensors and joints that are not set ask nothing.",
        default=(),
        option=False,
    )
    undecided: Undecided = field(
        "What an undecided verdict counts as: fail (exit code 1), or pass. A limit is undecided where nothing is "
        "wrong, and the error bar with its guard band reaches over it.",
        default="fail",
        option="What an undecided verdict counts as: fail or pass (fail).",
    )
    software: Annotated[Software, records.Converted(Software, checked_software)] | None = field(
        "The team's own calibration, in the place of our engine, which then only compares.",
        default=None,
        option=False,
    )
    exports: Exports | None = field("Exports if it passes: formats, robot-description.", default=None, option=False)
    copies: Copies = field(
        "Collections whose labels are those of another one, to the last digit: leave-out, with a warning that names "
        "them; refuse, for a recording that must have none.",
        default="leave-out",
        option="Collections that are exact copies: leave-out or refuse (leave-out).",
    )
    datasets: Datasets = field(
        "What a cell keeps of its calibrated dataset: full, ATOM's form, which any tool reads; changes, only what was "
        "calibrated, beside a reference to the dataset, for the commands here; none, which leaves the results, and no "
        "figures in the page.",
        default="full",
        option="What a cell keeps of its calibrated dataset: full, changes (beside a reference to it), none (full).",
    )
    accepted: Accepted | None = None
    """Accepted calibration to compare its cells with, set after reading it."""

    @property
    def judging_limits(self) -> Limits:
        """Its limits; by its tasks if one of them has a limit."""
        return replace(self.limits, by_tasks=any(task.limit is not None for task in self.tasks))

    @property
    def collected(self) -> str | None:
        """Entry of ``simulation`` that collects its dataset, whose path only a run knows."""
        place = str(self.dataset)
        return place.removeprefix(COLLECTED_PREFIX) if place.startswith(COLLECTED_PREFIX) else None


Magnitudes = Annotated[tuple[Annotated[float, records.between(0, 1000)], ...], records.length(1), records.UNIQUE]


Seeds = Annotated[tuple[Annotated[int, records.at_least(0)], ...], records.length(1), records.UNIQUE]


def chosen_systems(systems: tuple[System, ...], names: tuple[str, ...]) -> tuple[System, ...]:
    """Return the systems of these names, or all if there are none.

    Raises:
        InputError: there is no such system.
    """
    known = {system.name: system for system in systems}
    for name in names:
        if name not in known:
            raise InputError(f"systems: there is no '{name}'{did_you_mean(name, known)} (known: {', '.join(known)})")
    return tuple(known[name] for name in names) if names else systems


@records.result
class NoiseGrid:
    """Noise of the initial guesses: every combination is one cell of the matrix."""

    translations: tuple[float, ...] = field("From 0.", unit="m", key="translation_noise", default=(0.0,))
    rotations: tuple[float, ...] = field("From 0.", unit="rad", key="rotation_noise", default=(0.0,))
    seeds: tuple[int, ...] = field("One start for each.", default=(1,))


@record(rules=(records.excludes("seeds", "seed-list"),))
class Noise:
    """Noise of the initial guesses: every combination is one cell of the matrix."""

    translation: Magnitudes | None = field(
        "Lengths of the displacement, m.", default=None, option="Errors of the starting translations, m: 0,0.5."
    )
    rotation: Magnitudes | None = field(
        "Sizes of the error of each Euler angle, rad.",
        default=None,
        option="Errors of the starting Euler angles, rad: 0,0.5.",
    )
    seeds: Annotated[int, records.between(1, 100_000)] | None = field(
        "Number of seeds: 1, 2, ...", default=None, option="Number of seeds for each pair of noises (1)."
    )
    seed_list: Seeds | None = field(
        "The seeds themselves.", default=None, option="The seeds themselves, instead of their number: 3,7."
    )

    def grid(self, other: NoiseGrid | None = None) -> NoiseGrid:
        """Return the grid; missing values are those of another one."""
        other = other or NoiseGrid()
        seeds = self.seed_list or (tuple(range(1, self.seeds + 1)) if self.seeds else other.seeds)
        return NoiseGrid(self.translation or other.translations, self.rotation or other.rotations, seeds)
