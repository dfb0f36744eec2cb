"""Case of the catalogue: a planted defect, judged as `make run` judges without a truth, and compared with the truth."""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.verdict.kind import Kind
from benchmarks.verdict.kinds import CLEAN, KINDS
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import Stratum, clean, generator
from calibration.base import CalibrationError, InputError
from calibration.base.tables.table import read_table
from calibration.base.tables.table_verdict import judge
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.diagnosis.limits import TWIST_UNITS, Limits, sizes
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.evaluation.truth import truth_error
from calibration.engine.geometry.transforms import inverse, local
from calibration.pipeline.matrix.cell_result import Cell, CellResult, nothing_yet
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.matrix import judge_cells
from calibration.pipeline.matrix.running_cell import calibrate_cell, table_of

BY_NAME: dict[str, Kind] = {kind.name: kind for kind in (CLEAN, *KINDS)}
SIGMAS, LEAST = 3.0, (1.0, 0.05)
"""Where no limit is set, a result may be off by so many standard deviations of a good robot, and by mm and degrees."""
Colour = Literal["red", "undecided", "green"]
CORNER = 0.69
"""Least slope of the rays at the corners of the images of the shipped systems' cameras."""
FOCAL_PX = 580.0
"""Focal length at which that corner is 400 px from the middle, as in an image of 640 x 480."""
AS_WELL = 10.0
"""Costs (squared standard deviations) that differ by less are alike: of so many tests none could tell."""


@dataclass(frozen=True)
class Case:
    """Defect, system and size of a case."""

    kind: str
    stratum: Stratum
    system: str
    size: int
    """Which of the kind's sizes."""
    seed: int
    limits: bool = True
    """Whether the user has calibration.yml's limits and assumptions, or has set nothing."""

    @property
    def planted(self) -> Kind:
        """The kind."""
        return BY_NAME[self.kind]

    def scene(self) -> Scene:
        """The scene with the defect in it."""
        base = clean(self.stratum, self.system, self.seed)
        rng = generator(self.kind, self.stratum, self.system, self.size, self.seed)
        return self.planted.plant(base, self.planted.sizes[self.size], rng)

    @property
    def allowed(self) -> Limits:
        """Largest allowed error of a result."""
        limits = clean(self.stratum, self.system, self.seed).system.limits
        return limits if self.limits else _where_none_is_set(self.stratum, self.system, self.seed)


@dataclass(frozen=True)
class Harm:
    """The largest errors of the calibration against the truth, without the gauge; None where there is none."""

    translation_mm: float
    rotation_deg: float
    joint_mm: float | None
    joint_deg: float | None

    def over(self, limits: Limits) -> float:
        """The largest share of a limit."""
        shares = [
            (self.translation_mm, limits.translation_mm),
            (self.rotation_deg, limits.rotation_deg),
            (self.joint_mm, limits.joint_mm),
            (self.joint_deg, limits.joint_deg),
        ]
        return max(value / limit for value, limit in shares if value is not None and limit)


@dataclass(frozen=True)
class Outcome:
    """Verdict on a case."""

    case: Case
    harm: Harm | None
    """None where there is no calibrated dataset."""
    limits: float | None
    """The harm in limits of calibration.yml: above 1 it is harmful."""
    clean_limits: float
    """The same of the scene without the defect."""
    red: bool
    undecided: bool
    """Whether nothing is wrong, but an error bar reaches over a limit: neither red nor green."""
    reasons: tuple[str, ...]
    kinds: tuple[str, ...]
    """Of the red findings."""
    named: int
    """The first reason that names the cause, from 1; 0 where none does."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    rms_red: bool
    """Whether rules for the table, an RMS limit, find it red: what ATOM's users would look at."""
    nees: tuple[float, ...]
    """Of each calibrated sensor of a clean scene: its squared error in stated standard deviations, over 6."""
    seconds: float
    invisible: bool
    """Whether the labels of an arm that is not as it is described fit as well as without the defect: one whose base is
    turned about the axis of its first joint only changes the camera's pose."""

    @property
    def harmful(self) -> bool:
        """Whether the defect moves something beyond its limit: on a good robot more than its small errors do."""
        if self.limits is None or self._displaced():
            return True
        return self.limits > 1 and self.limits - self.clean_limits > 0.5

    def _displaced(self) -> bool:
        """Whether a sensor or its image was moved by more than it may be off, or a lens by as much at the corners."""
        planted, allowed = self.case.planted, self.case.allowed
        size = planted.sizes[self.case.size]
        if planted.unit in ("share", "px"):
            turn = np.degrees(size / FOCAL_PX if planted.unit == "px" else size * CORNER / (1 + CORNER**2))
            return planted.displaces and allowed.rotation_deg is not None and turn > allowed.rotation_deg
        limit, moved = (allowed.rotation_deg, size) if planted.unit == "deg" else (allowed.translation_mm, 1e3 * size)
        return planted.displaces and limit is not None and moved > limit

    @property
    def memory(self) -> bool:
        """Whether only an earlier result could tell."""
        return self.invisible or self.case.system in self.case.planted.memory

    @property
    def must_be_red(self) -> bool:
        """Harmful, or a mistake that a user has to correct."""
        planted = self.case.planted
        return self.harmful or planted.sizes[self.case.size] in planted.wanted

    @property
    def must_be_green(self) -> bool:
        """Harmless, and nothing that a user has to correct."""
        return not (self.must_be_red or self.case.planted.spoils) and (self.limits or 0) <= 1


def run(case: Case) -> Outcome:
    """Plant, judge, compare."""
    scene = case.scene()
    begin = time.perf_counter()
    result, rms_red, calibration = judged(scene if case.limits else with_nothing_set(scene))
    seconds = time.perf_counter() - begin
    harm = harm_of(calibration.dataset, scene) if calibration else None
    limits = case.allowed
    return Outcome(
        case=case,
        harm=harm,
        limits=harm.over(limits) if harm else None,
        clean_limits=_clean_limits(case),
        red=colour_of(result) == "red",
        undecided=colour_of(result) == "undecided",
        reasons=result.reasons,
        kinds=tuple(f.kind for f in result.findings if f.severity == "red"),
        named=_named(result, case.planted),
        warnings=result.warnings,
        notes=tuple(f.text for f in result.findings if f.severity == "note"),
        rms_red=rms_red,
        nees=tuple(_nees(case, scene)) if case.kind == CLEAN.name else (),
        seconds=seconds,
        invisible=calibration is not None and fits_as_well(case, scene),
    )


def colour_of(result: CellResult) -> Colour:
    """Whether the verdict is red, undecided or green; whatever a user makes of undecided."""
    undecided = {finding.text for finding in result.findings if str(finding.severity) == "undecided"}
    if not result.converged or set(result.reasons) - undecided:
        return "red"
    return "undecided" if undecided else "green"


def fits_as_well(case: Case, scene: Scene) -> bool:
    """Whether an arm that is not as it is described costs what the described one would, with the same noise."""
    if case.planted.group != "arm":
        return False
    found = _calibrated_clean(case.stratum, case.system, case.seed)
    options = replace(scene.system.options, noise_levels=found.noise_levels)
    return calibrate(scene.told, options).cost - found.cost < AS_WELL


@cache
def _calibrated_clean(stratum: Stratum, system: str, seed: int) -> Calibration:
    scene = clean(stratum, system, seed)
    return calibrate(scene.told, scene.system.options)


def judged(scene: Scene) -> tuple[CellResult, bool, Calibration | None]:
    """The verdict on one start without noise, whether the rules for the table alone are red, and the calibration."""
    entry = scene.system
    evaluation = parse_evaluation(entry.evaluate) if entry.evaluate else None
    loaded = LoadedSystem(entry.name, scene.told, None, evaluation, entry.options, entry.judging_limits, entry.tasks)
    try:
        check_data(scene.told)
    except InputError as error:
        return nothing_yet(Cell(entry.name, StartingNoise())).failing(str(error)), True, None
    with tempfile.TemporaryDirectory() as temporary, np.errstate(all="ignore"):
        result, calibration = calibrate_cell(Cell(entry.name, StartingNoise()), loaded)
        violated = True
        try:
            table = None
            if calibration is not None and np.isfinite(calibration.cost):
                table = table_of(calibration.dataset, loaded, calibration)
            if table is not None:
                table.write(Path(temporary) / TABLE)
                result = replace(result, table=TABLE)
                written = read_table(Path(temporary) / TABLE)
                violated = bool(entry.rules and judge(written, entry.rules).violations)
            [result] = judge_cells([result], [entry], Path(temporary))
        except CalibrationError as error:
            result = replace(result.failing(str(error)), converged=False, error=error.exit_code)
    return result, violated, calibration


TABLE = "table.csv"


def harm_of(calibrated: Dataset, scene: Scene) -> Harm | None:
    """Error of a calibrated dataset against the world of a scene; None if it cannot be measured."""
    try:
        error = truth_error(calibrated, scene.truth())
    except InputError:
        return None
    return Harm(error.translation_mm, error.rotation_deg, error.joint_mm, error.joint_deg)


def with_nothing_set(scene: Scene, limits: Limits | None = None) -> Scene:
    """The scene of a user who has set nothing but, perhaps, limits: no rules, no assumptions."""
    options = replace(scene.system.options, assume=Assumptions())
    return replace(scene, system=replace(scene.system, limits=limits or Limits(), options=options, rules=None))


def _nees(case: Case, scene: Scene) -> Iterator[float]:
    """Squared errors in standard deviations, over their expectation; relative to the sensor that is held.

    What is exact is known to be, and on robots by default as well as usual.
    """
    assume = ALL_EXACT if case.stratum == "exact" else Assumptions()
    calibration = calibrate(scene.told, replace(scene.system.options, assume=assume))
    found, truth = calibration.dataset, scene.truth()
    true = found.with_transforms(truth.transforms)
    shift = np.eye(4)
    if calibration.gauge in found.sensors:
        held = found.sensors[str(calibration.gauge)].frame
        shift = (found.transform(found.world, held) @ inverse(true.transform(found.world, held)))[0]
    for sensor in found.sensors.values():
        covariance = calibration.covariances.get(sensor.edge)
        if covariance is None:
            continue
        T_world_parent = found.transform(found.world, sensor.calibration_parent)[0]
        T_true = inverse(T_world_parent) @ shift @ T_world_parent @ truth.transforms[sensor.edge]
        error = local(calibration.transforms[sensor.edge], T_true)
        yield float(error @ np.linalg.solve(covariance, error)) / 6


def _clean_limits(case: Case) -> float:
    """The harm of the same scene without the defect."""
    if case.kind == CLEAN.name:
        return 0.0
    found = _run_clean(replace(case, kind=CLEAN.name, size=0)).limits
    return found if found is not None else 0.0


@cache
def _run_clean(case: Case) -> Outcome:
    return run(case)


@cache
def _where_none_is_set(stratum: Stratum, system: str, seed: int) -> Limits:
    """Three standard deviations of the worst sensor of the scene without a defect, where its collections agree.

    They are written here, not taken from the verdict that is measured.
    """
    scene = with_nothing_set(clean(stratum, system, seed))
    found = calibrate(scene.told, scene.system.options)
    assert found.error_bars
    expected, setup = found.error_bars.expected, found.solution.setup
    blocks = [setup.block(sensor.edge) for sensor in scene.told.sensors.values()]
    each = [
        sizes(np.sqrt(np.diagonal(expected[block])), TWIST_UNITS) for block in blocks if expected.get(block) is not None
    ]
    mm, deg = (
        max(least, *(SIGMAS * one for one in of)) for least, of in zip(LEAST, zip(*each, strict=True), strict=True)
    )
    return Limits(translation_mm=mm, rotation_deg=deg, joint_mm=LEAST[0], joint_deg=LEAST[1])


def _named(result: CellResult, kind: Kind) -> int:
    """Number from 1 of the first reason that has one of the words, or is such a finding; 0 without any."""
    kinds = {finding.text: finding.kind for finding in result.findings}
    for number, reason in enumerate(result.reasons, 1):
        said = f"{reason} {kinds.get(reason, '')}".lower()
        if not reason.startswith("RMS (pix)") and any(word in said for word in kind.words):
            return number
    return 0
