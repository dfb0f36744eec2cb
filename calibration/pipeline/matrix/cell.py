"""Cell of the matrix: one system calibrated from one noisy initial guess, and its output files."""

import math
import time
from collections.abc import Mapping
from dataclasses import field as dataclass_field
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.baseline.comparison import Change
from calibration.baseline.snapshot import Snapshot, snapshot
from calibration.baseline.verdict import Accepted, against_baseline
from calibration.comparison.methods import METHODS, method_of
from calibration.dataset.model import Dataset, Edge
from calibration.dataset.truth import Truth
from calibration.dataset.writing import DatasetWriter
from calibration.diagnosis.against_optimum import OurOptimum, find_optimum
from calibration.diagnosis.check_data import check_data
from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.finding import Finding
from calibration.diagnosis.limits import Limits
from calibration.diagnosis.mirrored import mirrored
from calibration.diagnosis.precision import worst_false_accept
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.intrinsics import CalibratedIntrinsics
from calibration.estimation.intrinsics_file import FILE_NAME as INTRINSICS
from calibration.estimation.intrinsics_file import write_intrinsics
from calibration.estimation.noise_levels import NoiseLevels
from calibration.estimation.options import Loss, Options, Start
from calibration.estimation.result import CalibratedJoint, Calibration, DroppedView, RejectedLabel
from calibration.estimation.starting_noise import StartingNoise, with_starting_noise
from calibration.estimation.wrong_views import without
from calibration.evaluation import measured_poses
from calibration.evaluation.reprojection import reprojection
from calibration.evaluation.specification import Evaluation
from calibration.evaluation.table import RMS_PIX, Table
from calibration.evaluation.truth import truth_error
from calibration.frozen import frozen
from calibration.geometry.rotations import rpy_rates, to_quaternion, to_rpy
from calibration.geometry.transforms import distance
from calibration.introspection.numbers import number_text
from calibration.records import computed, field, record, result
from calibration.report import Verdict
from calibration.report.outcome import ErrorCode

REPROJECTION = "reprojection.csv"
"""Default table, of a system that names none."""
OUR_METHOD = "calibration-ci"
MOST_CAUSES = 5
"""Limit of the reported contributions to the uncertainty."""


@frozen(eq=False)
class LoadedSystem:
    """System with its data in memory."""

    name: str
    dataset: Dataset
    truth: Truth | None
    evaluation: Evaluation | None
    options: Options = dataclass_field(default_factory=Options)
    """Options of our engine."""
    limits: Limits = dataclass_field(default_factory=Limits)
    """Limits of its result's errors."""
    accepted: Accepted | None = None
    """Accepted calibration to compare with; None if there is none."""

    def check(self) -> None:
        """Refuse data that would calibrate to nonsense; checked once, however many cells there are.

        Raises:
            InputError: there is a fault.
        """
        return self._sound

    @cached_property
    def _sound(self) -> None:
        check_data(self.dataset)

    @cached_property
    def writer(self) -> DatasetWriter:
        """Writer of its cells' calibrated datasets."""
        return DatasetWriter(self.dataset)

    @cached_property
    def optimum(self) -> OurOptimum:
        """Optimum of our engine, which does not depend on an initial guess.

        Raises:
            InputError: there is none.
        """
        return find_optimum(self.dataset, self.options)


@frozen
class Cell:
    """System and initial guess of a cell."""

    system: str
    noise: StartingNoise
    start: Start = "linear"
    loss: Loss = "huber"

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        return f"{self.system}/{noise_folder(self.noise)}"

    def __str__(self) -> str:
        n = self.noise
        return f"{self.system}, {noise_text(n.translation, n.rotation)}, seed {n.seed}"


@frozen
class Comparison:
    """Comparison method on a system's data."""

    system: str
    method: str
    noise: StartingNoise | None
    """Noise of the initial guess, of a method that uses one; else None."""

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        folder = f"{self.system}/{self.method}"
        return folder if self.noise is None else f"{folder}/{noise_folder(self.noise)}"


@record(case="snake", unknown="ignore")
class Deviation:
    """Largest errors of sensors and joints: against the truth, gauge removed, or by the calibration's covariance."""

    translation_mm: float = field("The worst of the sensors, the norm of three axes.")
    rotation_deg: float = field("The worst of the sensors, the norm of three axes.")
    joint_mm: float | None = field("The worst of the joints' parameters that are lengths.", default=None)
    joint_deg: float | None = field("The worst of the joints' parameters that are angles.", default=None)


@result
class Parameter:
    """Calibrated parameter of a joint or a camera."""

    name: str = field("The joint or the camera.")
    parameter: str = field("Name of the parameter.")
    value: float = field("The calibrated value.")
    unit: Literal["m", "rad", "px", "1"] = field("Of value and sigma.")
    sigma: float | None = field("Standard deviation; null if it did not converge.")


@result
class Transform:
    """Calibrated transform."""

    parent: str = field("The parent frame.")
    child: str = field("The child frame.")
    trans: tuple[float, ...] = field("Translation.", unit="m")
    quat: tuple[float, ...] = field("Rotation, a quaternion xyzw.")
    sigma_mm: float | None = field("Standard deviation of the translation, the norm of three axes.", unit="mm")
    sigma_mrad: float | None = field("Standard deviation of the rotation, the norm of three axes.", unit="mrad")
    rpy: tuple[float, ...] = field("The rotation as roll, pitch and yaw, as a URDF has it.", unit="rad", default=())
    sigma_trans: tuple[float, ...] | None = field(
        "Standard deviation of each coordinate of the translation; null if it was fixed.", unit="m", default=None
    )
    sigma_rpy: tuple[float, ...] | None = field("Standard deviation of roll, pitch and yaw.", unit="rad", default=None)
    moved_mm: float | None = field(
        "Distance of the translation from the dataset's own; null if that carries no information.",
        unit="mm",
        default=None,
    )
    moved_deg: float | None = field("The angle to the dataset's own rotation.", unit="degrees", default=None)


@result
class Worth:
    """Contribution of a fixed parameter's usual uncertainty to the result."""

    cause: str = field("What is held.")
    mm: float = field("Largest displacement of a transform.", unit="mm")


@result(kw_only=True)
class Details:
    """Details of a calibration, in a cell's own results but not in those of the matrix."""

    transforms: tuple[Transform, ...] = field("In the cell's own results: the transforms.", default=())
    joints: tuple[Parameter, ...] = field("In the cell's own results: those of joints.", default=())
    intrinsics: tuple[Parameter, ...] = field("In the cell's own results: those of cameras.", default=())
    iterations: int | None = field("Of the solver.", default=None)
    cost: float | None = field("Half the weighted sum of squares.", default=None)
    degrees_of_freedom: int | None = field("Residuals less parameters.", default=None)
    noise_levels: NoiseLevels | None = field("Standard deviations of the labels.", default=None)
    held: str | None = field("Sensor that is fixed because only relative poses are known.", default=None)
    weak_directions: tuple[str, ...] = field("Directions that the data hardly determine.", default=())
    rejected_labels: tuple[RejectedLabel, ...] = field("Labels that do not fit.", default=())
    dropped_views: tuple[DroppedView, ...] = field("Views that contradict the others and were left out.", default=())
    effective_collections: float | None = field(
        "Number of independent collections of equal weight with the same information.", default=None
    )
    hangs_on: tuple[Worth, ...] = field("Contributions to the uncertainty of the result, largest first.", default=())
    snapshot: Snapshot | None = field("The result as `calibration accept` keeps it.", default=None)
    changes: tuple[Change, ...] = field("Differences from the accepted calibration.", default=())


@result(kw_only=True)
class CellResult:
    """Result of a cell, or of a comparison method on a system's data."""

    system: str = field("The system that was calibrated.")
    method: str = field("calibration-ci, software (the team's own), or another method.")
    translation_noise: float | None = field("None for another method that takes no start.", unit="m")
    rotation_noise: float | None = field("Of the start.", unit="rad")
    seed: int | None = field("Of the noise.")
    start: str | None = field("linear or given.")
    loss: str | None = field("huber or linear.", default=None)
    converged: bool = field("Whether an optimum was found.")
    rms_px: float | None = field("Averages of the table, or of the reprojected corners.", unit="px")
    poses: Deviation | None = field(
        "Averages of the table of measured poses: how far they are from those of the result.", default=None
    )
    table: str | None = field("The CSV, relative to the output folder.")
    dataset: str | None = field("The calibrated dataset, relative to the output folder.")
    truth: Deviation | None = field("Distance of the calibration from the truth, if that is known.")
    seconds: float = field("Duration.")
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())
    error: ErrorCode | None = field("Exit code of a cell that could not be calibrated.", default=None)
    warnings: tuple[str, ...] = field("Warnings.", default=())
    findings: tuple[Finding, ...] = field(
        "What speaks for and against the calibration. The red ones are among the reasons, the warnings among the "
        "warnings.",
        default=(),
    )
    details: Details | None = field(flat=True, default=None)
    sigma: Deviation | None = field("Standard deviations that our engine states, in all.", default=None)
    label_sigma: Deviation | None = field("Largest standard deviations by the noise of the labels alone.", default=None)
    false_accept: float | None = field(
        "Probability that a sensor is off by more than the limits, by the standard deviations in all.", default=None
    )
    detail: str | None = field("Implementation of another method, and the data that it uses.", default=None)

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Pass, if there is no reason to fail."""
        return "pass" if self.converged and not self.reasons else "fail"

    @property
    def by_other_method(self) -> bool:
        """Whether it is from a comparison method; it is not judged."""
        return self.method in METHODS

    @property
    def start_of_cell(self) -> tuple[str, float | None, float | None, int | None]:
        """Key of the initial guess, equal for all results from it."""
        return (self.system, self.translation_noise, self.rotation_noise, self.seed)

    @property
    def name(self) -> str:
        """Name in messages."""
        if self.translation_noise is None or self.rotation_noise is None:
            return f"{self.system}, {self.method}"
        who = f"{self.system}, {self.method}" if self.by_other_method else self.system
        return f"{who}, {noise_text(self.translation_noise, self.rotation_noise)}, seed {self.seed}"

    def failing(self, *reasons: str) -> "CellResult":
        """Return the result with additional reasons to fail."""
        return replace(self, reasons=(*self.reasons, *reasons))

    def found(self, findings: tuple[Finding, ...]) -> "CellResult":
        """Return the result with additional findings, and their reasons and warnings."""
        texts = {severity: [f.text for f in findings if f.severity == severity] for severity in ("red", "warning")}
        return replace(
            self,
            findings=(*self.findings, *findings),
            reasons=(*self.reasons, *texts["red"]),
            warnings=(*self.warnings, *texts["warning"]),
        )


def noise_folder(noise: StartingNoise) -> str:
    """Return the name of the folder for results of an initial guess."""
    return f"translation-{number_text(noise.translation)}_rotation-{number_text(noise.rotation)}_seed-{noise.seed}"


def noise_text(translation: float, rotation: float) -> str:
    """Format a pair of noises with all digits: "0.5 m, 0.1 rad"."""
    return f"{number_text(translation)} m, {number_text(rotation)} rad"


def nothing_yet(cell: Cell, method: str = OUR_METHOD, start: str | None = None) -> CellResult:
    """Empty result, for a cell that has not run."""
    return CellResult(
        system=cell.system,
        method=method,
        translation_noise=cell.noise.translation,
        rotation_noise=cell.noise.rotation,
        seed=cell.noise.seed,
        start=start or cell.start,
        loss=cell.loss if method == OUR_METHOD else None,
        converged=False,
        rms_px=None,
        table=None,
        dataset=None,
        truth=None,
        seconds=0.0,
    )


def run_cell(cell: Cell, system: LoadedSystem, output: Path, folder: str | None = None) -> CellResult:
    """Calibrate, evaluate, and write the calibrated dataset and the table into a folder, by default the cell's.

    An error of the data is not raised but stored in the cell's result, so that the other cells continue.
    """
    begin = time.perf_counter()
    result, calibration = calibrate_cell(cell, system)
    try:
        if calibration is not None and np.isfinite(calibration.cost):
            result = _written(result, calibration.dataset, system, output, folder or cell.folder, calibration)
            result = _compared(result, calibration, system)
    except CalibrationError as error:
        result = _failed(result, error)
    return replace(result, seconds=round(time.perf_counter() - begin, 4))


def calibrate_cell(cell: Cell, system: LoadedSystem) -> tuple[CellResult, Calibration | None]:
    """Calibrate and diagnose; without evaluation and files.

    Returns:
        The result so far, and the calibration; None if the data cannot be calibrated, for a reason in the result.
    """
    result = nothing_yet(cell)
    try:
        system.check()
        options = replace(system.options, start=cell.start, loss=cell.loss)
        calibration = calibrate(system.dataset, options, cell.noise)
        return _described(result, calibration, system.dataset, system.limits).found(
            diagnose(calibration, system.dataset, options, system.limits, system.truth is not None)
        ), calibration
    except CalibrationError as error:
        return _failed(result, error).found(mirrored(None, system.dataset, system.options)), None


def _compared(result: CellResult, calibration: Calibration, system: LoadedSystem) -> CellResult:
    """Return the result with its snapshot, and the differences from the accepted calibration."""
    if not calibration.converged or result.details is None:
        return result
    now = snapshot(calibration, system.dataset, result.rms_px, system.options)
    comparison, findings = against_baseline(system.accepted, now) if system.accepted else (None, ())
    changes = comparison.changes if comparison else ()
    return replace(result, details=replace(result.details, snapshot=now, changes=changes)).found(findings)


def _failed(result: CellResult, error: CalibrationError) -> CellResult:
    return replace(result.failing(str(error)), converged=False, error=error.exit_code)


def run_comparison(comparison: Comparison, system: LoadedSystem, output: Path) -> CellResult:
    """Calibrate with another method, and evaluate like a cell."""
    begin = time.perf_counter()
    result = _nothing_by_other_method(comparison)
    try:
        method = method_of(comparison.method)
        start = with_starting_noise(system.dataset, comparison.noise) if comparison.noise else system.dataset
        dataset = method.calibrate(start)
        result = replace(result, converged=True, detail=method.describe(start))
        part = method.part(dataset)
        if system.evaluation and not set(system.evaluation.sensors) <= part.sensors.keys():
            system = replace(system, evaluation=None)  # its table is of a sensor that the method does not calibrate
        result = _written(result, dataset, system, output, comparison.folder, None, part)
    except CalibrationError as error:
        result = _failed(result, error)
    return replace(result, seconds=round(time.perf_counter() - begin, 4))


def _nothing_by_other_method(comparison: Comparison) -> CellResult:
    noise = comparison.noise
    return CellResult(
        system=comparison.system,
        method=comparison.method,
        translation_noise=noise.translation if noise else None,
        rotation_noise=noise.rotation if noise else None,
        seed=noise.seed if noise else None,
        start="given" if noise else None,
        loss=None,
        converged=False,
        rms_px=None,
        table=None,
        dataset=None,
        truth=None,
        seconds=0.0,
    )


def _written(
    result: CellResult,
    dataset: Dataset,
    system: LoadedSystem,
    output: Path,
    folder: str,
    calibration: Calibration | None,
    part: Dataset | None = None,
) -> CellResult:
    """Return the result with its table, truth error and dataset; write both files.

    The table and the error are of the sensors of a part of the dataset, by default of all.
    """
    judged = dataset if part is None else part
    table = table_of(judged, system, calibration)
    if table is not None:
        name = f"{system.evaluation.kind.replace('-', '_')}_results.csv" if system.evaluation else REPROJECTION
        table.write(output / folder / name)
        rms = round(table.average(RMS_PIX), 4) if RMS_PIX in table.columns else None
        result = replace(result, table=f"{folder}/{name}", rms_px=rms)
        if table.columns == measured_poses.COLUMNS:
            mm, deg = (round(table.average(column), 4) for column in table.columns)
            result = replace(result, poses=Deviation(mm, deg))
    if calibration is not None and (system.evaluation is None or result.rms_px is None):
        result = replace(result, rms_px=None if math.isnan(calibration.rms_px) else round(calibration.rms_px, 4))
    result = replace(result, truth=distance_from_truth(judged, system))
    system.writer.write(dataset, output / folder, images=False)  # without images, which are larger than everything else
    if calibration is not None and calibration.converged and calibration.intrinsics:
        write_intrinsics(output / folder / INTRINSICS, calibration.intrinsics)
    return replace(result, dataset=f"{folder}/dataset.json")


def distance_from_truth(dataset: Dataset, system: LoadedSystem) -> Deviation | None:
    """Compare a calibrated dataset of a system with its truth, if that is known.

    Raises:
        InputError: the dataset and the truth are inconsistent.
    """
    if system.truth is None:
        return None
    error = truth_error(dataset, system.truth)
    return _deviation(error.translation_mm, error.rotation_deg, error.joint_mm, error.joint_deg)


def table_of(dataset: Dataset, system: LoadedSystem, calibration: Calibration | None) -> Table | None:
    """Evaluate a calibrated dataset: by the system's table, else the reprojection errors of a calibration.

    Views that the calibration has rejected, because they contradict the others, are left out.
    """
    if system.evaluation is not None:
        counted = dataset if calibration is None else without(dataset, calibration.dropped_views)
        return system.evaluation.run(counted, system.truth)
    return reprojection(calibration) if calibration is not None else None


def _described(result: CellResult, calibration: Calibration, description: Dataset, limits: Limits) -> CellResult:
    """Return the result with the calibration's own statistics."""
    details = Details(
        transforms=tuple(_transform(calibration, description, edge) for edge in calibration.transforms),
        joints=tuple(row for joint in calibration.joints.values() for row in _parameters(joint.name, joint)),
        intrinsics=tuple(row for name, camera in calibration.intrinsics.items() for row in _parameters(name, camera)),
        iterations=calibration.iterations,
        cost=calibration.cost,
        degrees_of_freedom=calibration.degrees_of_freedom,
        noise_levels=calibration.noise_levels,
        held=calibration.gauge,
        weak_directions=tuple(calibration.weak_directions),
        rejected_labels=tuple(calibration.rejected),
        dropped_views=calibration.dropped_views,
        effective_collections=round(bars.effective_collections, 2) if (bars := calibration.error_bars) else None,
        hangs_on=_hangs_on(bars.worth) if bars else (),
    )
    return replace(
        result,
        converged=calibration.converged,
        sigma=_sigma(calibration) if calibration.converged else None,
        label_sigma=_sigma(calibration, labels_only=True) if calibration.converged else None,
        false_accept=worst_false_accept(calibration, limits) if calibration.converged else None,
        reasons=(calibration.reason,) if calibration.reason else (),
        details=details,
    )


def _transform(calibration: Calibration, description: Dataset, edge: Edge) -> Transform:
    """Return a calibrated transform with its standard deviations, and its distance from the robot's description.

    A twist in the child frame changes the translation by ``R`` times its own, and roll, pitch and yaw by `rpy_rates`.
    """
    T, C, described = calibration.transforms[edge], calibration.covariances.get(edge), description.transforms.get(edge)
    rpy = to_rpy(T[:3, :3])
    known = C is not None and calibration.converged
    of_trans = of_rpy = None
    if C is not None and known:
        J = np.zeros((6, 6))
        J[:3, :3], J[3:, 3:] = T[:3, :3], rpy_rates(rpy)
        sigmas = np.sqrt(np.diagonal(J @ C @ J.T))
        of_trans = tuple(sigmas[:3].tolist())
        of_rpy = tuple(sigmas[3:].tolist()) if np.isfinite(sigmas).all() else None
    moved = None
    if described is not None and np.isfinite(described[0]).all() and not np.array_equal(described[0], np.eye(4)):
        moved = distance(described[0], T)
    return Transform(
        *edge,
        tuple(T[:3, 3].tolist()),
        tuple(to_quaternion(T[:3, :3]).tolist()),
        calibration.sigma_mm(edge) if C is not None else None,
        calibration.sigma_mrad(edge) if C is not None else None,
        tuple(rpy.tolist()),
        of_trans,
        of_rpy,
        None if moved is None else round(1e3 * float(moved[0]), 6),
        None if moved is None else round(float(np.degrees(moved[1])), 8),
    )


def _hangs_on(worth: Mapping[str, float]) -> tuple[Worth, ...]:
    """Return the contributions to the uncertainty that matter, largest first."""
    largest = sorted(worth.items(), key=lambda each: -each[1])[:MOST_CAUSES]
    return tuple(Worth(name, round(1e3 * metres, 4)) for name, metres in largest if metres > 0)


def _sigma(calibration: Calibration, labels_only: bool = False) -> Deviation | None:
    """Return the largest standard deviations of sensors, as norms of three axes, and of joints' parameters."""
    edges = {sensor.edge for sensor in calibration.dataset.sensors.values()} & calibration.covariances.keys()
    if not edges:
        return None
    mm, mrad = calibration.sigma_mm, calibration.sigma_mrad
    if labels_only:
        mm, mrad = calibration.label_sigma_mm, calibration.label_sigma_mrad
    joints = [] if labels_only else list(calibration.joints.values())
    sigmas = [each for joint in joints for each in zip(joint.units, joint.sigmas.tolist(), strict=True)]
    return _deviation(
        max(map(mm, edges)),
        float(np.degrees(max(map(mrad, edges)) / 1e3)),
        max((1e3 * sigma for unit, sigma in sigmas if unit == "m"), default=None),
        max((float(np.degrees(sigma)) for unit, sigma in sigmas if unit == "rad"), default=None),
    )


def _deviation(
    translation_mm: float, rotation_deg: float, joint_mm: float | None, joint_deg: float | None
) -> Deviation:
    """Round to a nanometre and a similarly small angle."""
    return Deviation(
        round(translation_mm, 6),
        round(rotation_deg, 8),
        None if joint_mm is None else round(joint_mm, 6),
        None if joint_deg is None else round(joint_deg, 8),
    )


def _parameters(name: str, calibrated: CalibratedJoint | CalibratedIntrinsics) -> list[Parameter]:
    """Return the parameters of a joint or a camera, one by one."""
    each = zip(
        calibrated.parameters, calibrated.values.tolist(), calibrated.units, calibrated.sigmas.tolist(), strict=True
    )
    return [
        Parameter(name, parameter, value, unit, sigma if math.isfinite(sigma) else None)
        for parameter, value, unit, sigma in each
    ]
