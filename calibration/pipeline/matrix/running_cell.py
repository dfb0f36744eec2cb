"""Run of one cell: calibrate, diagnose, evaluate, compare, and write its files."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.baseline.verdict import against_baseline
from calibration.comparison.methods import method_of
from calibration.dataset.model import Dataset
from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.mirrored import mirrored
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.intrinsics_file import FILE_NAME as INTRINSICS
from calibration.estimation.intrinsics_file import write_intrinsics
from calibration.estimation.result import Calibration
from calibration.estimation.starting_noise import with_starting_noise
from calibration.estimation.wrong_views import without
from calibration.evaluation import measured_poses
from calibration.evaluation.reprojection import reprojection
from calibration.evaluation.table import RMS_PIX, Table
from calibration.evaluation.truth import truth_error
from calibration.pipeline.matrix.cell import REPROJECTION, Cell, Comparison
from calibration.pipeline.matrix.cell_details import described, rounded_deviation
from calibration.pipeline.matrix.cell_result import CellResult, Deviation, nothing_by_other_method, nothing_yet
from calibration.pipeline.matrix.loaded_system import LoadedSystem


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
        return described(result, calibration, system.dataset, system.limits).found(
            diagnose(calibration, system.dataset, options, system.limits, system.truth is not None)
        ), calibration
    except CalibrationError as error:
        return _failed(result, error).found(mirrored(None, system.dataset, system.options)), None


def _compared(result: CellResult, calibration: Calibration, system: LoadedSystem) -> CellResult:
    """Return the result with its snapshot, and the differences from the accepted calibration."""
    if not calibration.converged or result.details is None:
        return result
    now = system.snapshots.of(calibration, result.rms_px)
    comparison, findings = against_baseline(system.accepted, now) if system.accepted else (None, ())
    changes = comparison.changes if comparison else ()
    return replace(result, details=replace(result.details, snapshot=now, changes=changes)).found(findings)


def _failed(result: CellResult, error: CalibrationError) -> CellResult:
    return replace(result.failing(str(error)), converged=False, error=error.exit_code)


def run_comparison(comparison: Comparison, system: LoadedSystem, output: Path) -> CellResult:
    """Calibrate with another method, and evaluate like a cell."""
    begin = time.perf_counter()
    result = nothing_by_other_method(comparison)
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
    return rounded_deviation(error.translation_mm, error.rotation_deg, error.joint_mm, error.joint_deg)


def table_of(dataset: Dataset, system: LoadedSystem, calibration: Calibration | None) -> Table | None:
    """Evaluate a calibrated dataset: by the system's table, else the reprojection errors of a calibration.

    Views that the calibration has rejected, because they contradict the others, are left out.
    """
    if system.evaluation is not None:
        counted = dataset if calibration is None else without(dataset, calibration.dropped_views)
        return system.evaluation.run(counted, system.truth)
    return reprojection(calibration) if calibration is not None else None
