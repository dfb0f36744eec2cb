"""Cells that a team's software calibrates: each a job in containers, judged by its output files."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from calibration.base import CalibrationError, ExitCode, InputError, number_text, parse_number, temporary_folder
from calibration.base.tables.table import KeyedTable, LabelledRow, read_table
from calibration.ci.execution.job import OUTPUT, Job, Mount
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, JobOutcome
from calibration.ci.execution.tasks import Task
from calibration.engine.baseline.calibration_document import SoftwareStart
from calibration.engine.baseline.verdict import against_baseline, nothing_accepted, software_against_baseline
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.diagnosis.against_optimum import against_optimum, optimum_for
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.software_output import moved_frames, not_evaluated, same_labels, table_follows
from calibration.engine.estimation.start.guesses import with_starting_noise
from calibration.engine.evaluation.table import AVERAGES_ROW, RMS_PIX
from calibration.pipeline.containers import (
    DATASET_FOLDER,
    NO_DATASET,
    SOFTWARE_METHOD,
    START_FOLDER,
    Software,
    job_of,
)
from calibration.pipeline.matrix.cell_result import Cell, CellResult, nothing_yet
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.running_cell import distance_from_truth

NOT_VERIFIED = Finding(
    "not-verified",
    "note",
    f"not verified: the software leaves no dataset (calibrated: {NO_DATASET}), its table is believed",
)


@contextmanager
def software_tasks(
    cells: Sequence[Cell], systems: Mapping[str, LoadedSystem], software: Mapping[str, Software], output: Path
) -> Iterator[Mapping[Cell, Task[CellResult]]]:
    """Create the tasks of the cells of systems with software; the files that it reads exist inside the ``with`` block.

    Args:
        cells: the initial guesses of all systems.
        systems: their data.
        software: the containers, of some systems.
        output: the folder of the jobs.

    Raises:
        InputError: a command has an unknown placeholder.
        InfrastructureError: a file cannot be written.
    """
    output.mkdir(parents=True, exist_ok=True)
    with temporary_folder(prefix=".starts-", parent=output) as starts:
        yield {
            cell: _task_of_cell(cell, systems[cell.system], software[cell.system], starts / str(number), output)
            for number, cell in enumerate(cells)
            if cell.system in software
        }


def _task_of_cell(cell: Cell, system: LoadedSystem, software: Software, start: Path, output: Path) -> Task[CellResult]:
    """Return the task of one cell, and write the dataset with its noisy initial guess.

    A failure of the software is stored in the result, so that the other cells continue.

    Args:
        cell: the initial guess.
        system: its data.
        software: the containers.
        start: a new folder for the dataset with the initial guess.
        output: the folder of the jobs.

    Raises:
        InputError: the command has an unknown placeholder.
        InfrastructureError: a file cannot be written.
    """
    write_dataset(with_starting_noise(system.dataset, cell.noise), start)
    job = cell_job(cell, software, system.dataset.path.parent, start)
    return Task.containers(job.name, job, lambda outcome: software_result(cell, system, software, outcome, output))


def cell_job(cell: Cell, software: Software, dataset: Path, start: Path) -> Job:
    """Return the job of one cell.

    Args:
        cell: the initial guess.
        software: the containers.
        dataset: the folder of the dataset as it is.
        start: the folder of the dataset with the noisy initial guess.

    Raises:
        InputError: the command has an unknown placeholder.
    """
    noise = cell.noise
    values = {
        "dataset": DATASET_FOLDER,
        "start": START_FOLDER,
        "output": OUTPUT,
        "system": cell.system,
        "translation_noise": number_text(noise.translation),
        "rotation_noise": number_text(noise.rotation),
        "seed": str(noise.seed),
    }
    mounts = (Mount(dataset.resolve(), DATASET_FOLDER), Mount(start.resolve(), START_FOLDER))
    return job_of(software, cell.folder, values, mounts, f"systems.{cell.system}.software")


def software_result(
    cell: Cell, system: LoadedSystem, software: Software, outcome: JobOutcome, output: Path
) -> CellResult:
    """Return the result of a cell by its files; if the job failed, only the reason."""
    result = replace(nothing_yet(cell, SOFTWARE_METHOD, start="given"), seconds=round(outcome.seconds, 4))
    if outcome.exit_code != ExitCode.PASS:
        error = None if outcome.exit_code == ExitCode.FAIL else outcome.exit_code
        return replace(result.failing(*outcome.reasons), error=error)
    folder = outcome.folder.relative_to(output)
    paths = [file.path for file in outcome.artifacts]
    try:
        result = _with_table(result, software, folder / ARTIFACTS_FOLDER, paths, output)
        if software.leaves_dataset:
            result = _with_dataset(result, cell, system, software, folder, paths, output)
        else:
            result = replace(result, converged=True).found((NOT_VERIFIED, *_findings_on_changes(system)))
    except CalibrationError as error:  # of files that the software wrote: it has failed
        return result.failing(str(error))
    if system.accepted is None:
        return result
    return result.found(software_against_baseline(system.accepted, start_of(result), system.snapshots.data))


def _with_table(result: CellResult, software: Software, files: Path, paths: Sequence[str], output: Path) -> CellResult:
    found = _only_artifact(paths, software.table or "*.csv", "table", required=not software.leaves_dataset)
    if found is None:
        return result
    return replace(result, table=str(files / found), rms_px=_average_rms(output / files / found))


def _with_dataset(
    result: CellResult,
    cell: Cell,
    system: LoadedSystem,
    software: Software,
    folder: Path,
    paths: Sequence[str],
    output: Path,
) -> CellResult:
    """Return the result by the calibrated dataset and the table; without a table, by the dataset's own."""
    try:
        path = folder / ARTIFACTS_FOLDER / str(_only_artifact(paths, software.calibrated, "calibrated", required=True))
    except InputError as error:
        raise InputError(
            f"{error}: its calibrated dataset (or say calibrated: {NO_DATASET}, to believe its table)"
        ) from None
    dataset = read_dataset(output / path, data=system.dataset.path.parent)
    return judged(replace(result, dataset=str(path)), dataset, cell, system, folder, output)


def judged(
    result: CellResult, dataset: Dataset, cell: Cell, system: LoadedSystem, folder: Path, output: Path
) -> CellResult:
    """Return the result by a calibrated dataset and the table.

    Args:
        result: so far, with its table if there is one.
        dataset: the software's calibrated dataset.
        cell: the initial guess.
        system: its data.
        folder: where the dataset's own table is written if the result has none, relative to ``output``.
        output: the folder of the jobs.

    Raises:
        InputError: the dataset cannot be evaluated, or the table cannot be read.
        InfrastructureError: the table cannot be written.
    """
    result = replace(result, converged=True)
    if other := same_labels(dataset, system.dataset):
        return result.found(other)
    result = replace(result, truth=distance_from_truth(dataset, system))
    result = result.found(_findings_on_distance(dataset, cell, system))
    if system.evaluation is None:
        return result if result.table is None else result.found(not_evaluated(result.rms_px, _reprojection_rms(system)))
    made = system.evaluation.run(dataset, system.truth)
    if result.table is not None:
        return result.found(table_follows(read_table(output / result.table), made))
    table = folder / system.evaluation.file_name
    made.write(output / table)
    return replace(result, table=str(table), rms_px=_average_rms(output / table))


def start_of(result: CellResult, passed: bool | None = None) -> SoftwareStart:
    """Return the part of a cell's result that the baseline stores."""
    return SoftwareStart(
        result.translation_noise or 0.0,
        result.rotation_noise or 0.0,
        result.seed or 0,
        result.verdict == "pass" if passed is None else passed,
        result.rms_px,
        next((each.moves_mm for each in result.findings if each.kind == "against-optimum"), None),
    )


def _findings_on_distance(dataset: Dataset, cell: Cell, system: LoadedSystem) -> tuple[Finding, ...]:
    """Return findings on the distance of a dataset from the optimum of the same labels."""
    try:
        optimum = optimum_for(system.optimum, dataset)
    except CalibrationError as error:
        text = f"not verified: our engine finds no optimum on the same labels: {error}"
        return (Finding("against-optimum", "red", text),)
    start = with_starting_noise(system.dataset, cell.noise)
    return (
        *moved_frames(dataset, system.dataset, system.limits),
        *against_optimum(optimum, dataset, start, system.limits),
        *system.findings_of(optimum),
        *_findings_on_changes(system),
    )


def _findings_on_changes(system: LoadedSystem) -> tuple[Finding, ...]:
    """Return findings on changes since the accepted calibration, by the optimum."""
    if system.accepted is None:
        return ()
    if system.accepted.snapshot is None:
        return nothing_accepted(system.accepted)
    now = against_baseline(system.accepted, system.optimum_snapshot)[1]
    return tuple(each for each in now if each.kind != "baseline-quality")


def _reprojection_rms(system: LoadedSystem) -> float:
    """Root mean square of the reprojection errors at the optimum, px; NaN if there are none."""
    try:
        return system.optimum.calibration.rms_px
    except CalibrationError:
        return math.nan


def _only_artifact(paths: Sequence[str], pattern: str, key: str, required: bool) -> str | None:
    """Return the only artifact whose path, or name, matches a pattern.

    Raises:
        InputError: there is more than one, or none although it is required.
    """
    found = [path for path in paths if fnmatchcase(path, pattern) or fnmatchcase(Path(path).name, pattern)]
    if len(found) == 1 or not (found or required):
        return found[0] if found else None
    listed = ", ".join(sorted(found or paths)[:8]) or "no file"
    raise InputError(f"{key}: the software left {listed}; expected exactly one file '{pattern}'")


def _average_rms(path: Path) -> float | None:
    """Return the average of the column `RMS`; None for a table without it.

    Raises:
        InputError: the file is not a table, or the value is not a finite number.
    """
    table = read_table(path)
    keyed = KeyedTable.of(table, None, ())
    if RMS_PIX not in table.header or AVERAGES_ROW not in keyed.labels:
        return None
    row = keyed.row(LabelledRow(AVERAGES_ROW))
    text = row.cells[table.column(RMS_PIX)] if row else ""
    number = parse_number(text)
    if number is None:
        raise InputError(
            f"{path}: row '{AVERAGES_ROW}', column '{RMS_PIX}': found '{text}', a finite number was expected"
        )
    return round(number, 4)
