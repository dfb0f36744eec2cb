"""Run of one cell: calibrate, diagnose, evaluate, compare, and write its files."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from calibration.base import CalibrationError, write_atomically
from calibration.engine.baseline.verdict import against_baseline
from calibration.engine.comparison import method_of
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.diagnosis.after_move import after_move
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.calibrate import solve
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.problem.intrinsics import FILE_NAME as INTRINSICS
from calibration.engine.estimation.problem.intrinsics import write_intrinsics
from calibration.engine.estimation.start.guesses import StartingNoise, with_starting_noise
from calibration.engine.estimation.start.wrong_views import without
from calibration.engine.evaluation.label_errors import reprojection
from calibration.engine.evaluation.table import RMS_PIX, Table
from calibration.engine.evaluation.truth import truth_error
from calibration.engine.tasks.task_errors import task_errors
from calibration.pipeline.matrix.cell_details import (
    described,
    documents_of_tasks,
    finite_deviation,
    given_projections,
    judged_tasks,
)
from calibration.pipeline.matrix.cell_result import (
    REPROJECTION_FILE,
    Cell,
    CellResult,
    Comparison,
    Deviation,
    for_cell,
    nothing_by_other_method,
    nothing_yet,
)
from calibration.pipeline.matrix.loaded_system import LoadedSystem

NO_FINITE_RMS = "corners lie behind a camera, or where its lens model has no inverse; is the lens model the right one?"


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Result of a calibrated dataset, and the texts of its files, before they are written."""

    result: CellResult
    calibration: Calibration | None = None
    """Calibration that it is of; None if it is of another method."""
    table: tuple[str, str] | None = None
    """Name of the table's file, and its text; None if there is no table."""
    dataset: str | None = None
    """Text of the dataset; None if it is not written."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Texts of further files, by name."""
    complete: bool = False
    """Whether all was evaluated without an error; then the result has a folder of its own files."""


def run_cell(cell: Cell, system: LoadedSystem, output: Path, folder: str | None = None) -> CellResult:
    """Calibrate, evaluate, and write the calibrated dataset and the table into a folder, by default the cell's.

    An error of the data is not raised but stored in the cell's result, so that the other cells continue.
    """
    begin = time.perf_counter()
    try:
        calibration = _calibrate_cell(cell, system)
        made = _evaluate_cell(cell, system, calibration)
    except CalibrationError as error:
        result = _without_calibration(cell, system, error)
    else:
        written = made.calibration or calibration
        result = _write_files(made, written.dataset, system, output, folder or cell.folder)
        result = for_cell(result, cell, calibration.iterations)
    return replace(result, seconds=round(time.perf_counter() - begin, 4))


def calibrate_cell(cell: Cell, system: LoadedSystem) -> tuple[CellResult, Calibration | None]:
    """Calibrate and diagnose; without evaluation and files.

    Returns:
        The result so far, and the calibration; None if the data cannot be calibrated, for a reason in the result.
    """
    try:
        calibration = _calibrate_cell(cell, system)
        return _diagnose_cell(cell, system, calibration), calibration
    except CalibrationError as error:
        return _without_calibration(cell, system, error), None


def _calibrate_cell(cell: Cell, system: LoadedSystem) -> Calibration:
    system.check()
    return solve(system.prepared, cell.noise)


def _without_calibration(cell: Cell, system: LoadedSystem, error: CalibrationError) -> CellResult:
    result = _failed_result(nothing_yet(cell), error).found(system.left_out)
    named = system.conventions
    return result.explained(named, Finding("engine", "note", str(error))) if named else result


def _diagnose_cell(cell: Cell, system: LoadedSystem, calibration: Calibration) -> CellResult:
    tasks = task_errors(calibration, system.tasks)
    result = described(nothing_yet(cell), calibration, system.dataset, system.limits, tasks, system.truth)
    found = diagnose(calibration, system.dataset, system.options, system.limits, system.truth is not None, tasks)
    result = replace(result, tasks=judged_tasks(result.tasks, found))
    result = result.explained(found) if any(each.kind == "convention" for each in found) else result.found(found)
    return result.found((*system.left_out, *system.lens_notes))


def _evaluate_cell(cell: Cell, system: LoadedSystem, calibration: Calibration) -> Evaluated:
    """Return all that follows from a calibration; for the cells that came to the prepared optimum it is one."""
    if calibration.solution is system.prepared.optimum.solution:
        return _evaluate_prepared_optimum(system)
    return _diagnose_and_evaluate(cell, system, calibration)


@lru_cache(maxsize=1)  # a process runs the cells of one system after those of another
def _evaluate_prepared_optimum(system: LoadedSystem) -> Evaluated:
    cell = Cell(system.name, StartingNoise(), system.options.start, system.options.loss)
    return _diagnose_and_evaluate(cell, system, system.prepared.optimum)


def _diagnose_and_evaluate(cell: Cell, system: LoadedSystem, calibration: Calibration) -> Evaluated:
    result = _diagnose_cell(cell, system, calibration)
    if not np.isfinite(calibration.cost):
        return Evaluated(result)
    calibration, said = after_move(calibration, result.findings, system.prepared, system.limits)
    if said:
        tasks = task_errors(calibration, system.tasks)
        described_now = described(nothing_yet(cell), calibration, system.dataset, system.limits, tasks, system.truth)
        described_now = replace(described_now, tasks=judged_tasks(described_now.tasks, result.findings))
        result = described_now.found((*result.findings, *said))
    made = _evaluate_dataset(result, calibration.dataset, system, calibration)
    if made.result.error is not None:
        return made
    made = _with_next_poses(_with_given_projections(made, calibration), calibration, system)
    return replace(made, result=_compare_with_accepted(made.result, calibration, system))


def _with_given_projections(made: Evaluated, calibration: Calibration) -> Evaluated:
    """Return the result with how sure the projection of cameras is whose intrinsics are given."""
    details = made.result.details
    if details is None or not calibration.converged:
        return made
    details = replace(details, projection=(*details.projection, *given_projections(calibration)))
    return replace(made, result=replace(made.result, details=details))


def _with_next_poses(made: Evaluated, calibration: Calibration, system: LoadedSystem) -> Evaluated:
    """Return the result with what to record next, if a limit is undecided and nothing is wrong."""
    result = made.result
    if result.details is None or result.verdict != "undecided" or not calibration.converged:
        return made
    from calibration.pipeline.next_poses import advise  # with the simulation; most results need none

    advised = advise(calibration, system, task_errors(calibration, system.tasks))
    details = replace(result.details, next_poses=advised.found)
    return replace(made, result=replace(result, details=details), files=advised.files)


def _compare_with_accepted(result: CellResult, calibration: Calibration, system: LoadedSystem) -> CellResult:
    """Return the result with its snapshot, and the differences from the accepted calibration."""
    if not calibration.converged or result.details is None or any(f.kind == "convention" for f in result.findings):
        return result
    now = replace(
        system.snapshots.of(calibration, result.rms_px),
        tasks=documents_of_tasks(result.tasks),
        promise=result.details.next_poses.promise if result.details.next_poses else None,
    )
    comparison, findings = against_baseline(system.accepted, now) if system.accepted else (None, ())
    changes = comparison.changes if comparison else ()
    return replace(result, details=replace(result.details, snapshot=now, changes=changes)).found(findings)


def _failed_result(result: CellResult, error: CalibrationError) -> CellResult:
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
        made = _evaluate_dataset(result, dataset, system, None, part)
        result = _write_files(made, dataset, system, output, comparison.folder)
    except CalibrationError as error:
        result = _failed_result(result, error)
    return replace(result, seconds=round(time.perf_counter() - begin, 4))


def _evaluate_dataset(
    result: CellResult,
    dataset: Dataset,
    system: LoadedSystem,
    calibration: Calibration | None = None,
    part: Dataset | None = None,
) -> Evaluated:
    """Return the result with its RMS and truth error, and its files; with the error if one of them cannot be made.

    The table and the error are of the sensors of a part of the dataset, by default of all.
    """
    judged = dataset if part is None else part
    made = Evaluated(result, calibration)
    try:
        table = table_of(judged, system, calibration)
        if table is not None:
            kind = system.evaluation.table if system.evaluation else None
            name = system.evaluation.file_name if system.evaluation else REPROJECTION_FILE
            column = kind.rms if kind else RMS_PIX
            rms = None if column is None else round(table.average(column), 4)
            if rms is not None and not math.isfinite(rms):
                text = f"{name}: found no finite RMS: {NO_FINITE_RMS}"
                result, rms = result.found((Finding("table", "red", text),)), None
            made = replace(made, result=replace(result, rms_px=rms), table=(name, table.to_csv()))
            if kind is not None and kind.poses is not None:
                mm, deg = (table.average(column) for column in kind.poses)
                poses = finite_deviation(f"the averages of {name}", round(mm, 4), round(deg, 4))
                made = replace(made, result=replace(made.result, poses=poses))
        if calibration is not None and (system.evaluation is None or made.result.rms_px is None):
            rms = round(calibration.rms_px, 4) if math.isfinite(calibration.rms_px) else None
            made = replace(made, result=replace(made.result, rms_px=rms))
        made = replace(made, result=replace(made.result, truth=distance_from_truth(judged, system)))
        return replace(made, dataset=system.dataset_text(dataset), complete=True)
    except CalibrationError as error:
        return replace(made, result=_failed_result(made.result, error))


def _write_files(
    made: Evaluated,
    dataset: Dataset,
    system: LoadedSystem,
    output: Path,
    folder: str,
) -> CellResult:
    """Write the files, and return the result with their names; with the error if one of them cannot be written."""
    result, calibration = made.result, made.calibration
    try:
        if made.table is not None:
            name, text = made.table
            write_atomically(output / folder / name, text)
            result = replace(result, table=f"{folder}/{name}")
        if made.dataset is not None:
            system.write_dataset(made.dataset, dataset, output / folder)
            result = replace(result, dataset=f"{folder}/{FILE_NAME}")
        for name, text in made.files.items():
            write_atomically(output / folder / name, text)
        if made.complete:
            if calibration is not None and calibration.converged and calibration.intrinsics:
                sensors = calibration.dataset.sensors
                cameras = {name: camera for name, sensor in sensors.items() if (camera := sensor.camera)}
                write_intrinsics(output / folder / INTRINSICS, calibration.intrinsics, cameras)
            result = replace(result, folder=folder)
    except CalibrationError as error:
        result = _failed_result(result, error)
    return result


def distance_from_truth(dataset: Dataset, system: LoadedSystem) -> Deviation | None:
    """Compare a calibrated dataset of a system with its truth, if that is known.

    Raises:
        InputError: the dataset and the truth are inconsistent.
    """
    if system.truth is None:
        return None
    error = truth_error(dataset, system.truth)
    numbers = (error.translation_mm, error.rotation_deg, error.joint_mm, error.joint_deg)
    return finite_deviation("the distance from the truth", *numbers)


def table_of(dataset: Dataset, system: LoadedSystem, calibration: Calibration | None) -> Table | None:
    """Evaluate a calibrated dataset: by the system's table, else the reprojection errors of a calibration.

    Views that the calibration has rejected, because they contradict the others, are left out.
    """
    if system.evaluation is not None:
        counted = dataset if calibration is None else without(dataset, calibration.dropped_views)
        return system.evaluation.run(counted, system.truth)
    return reprojection(calibration) if calibration is not None else None
