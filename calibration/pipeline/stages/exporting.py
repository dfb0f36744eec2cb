"""Stage export: files for the robot of each system that passed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calibration.base import CalibrationError, write_atomically
from calibration.base.records import field, result, text_of
from calibration.ci.report import Verdict
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import Exported, own_details
from calibration.pipeline.stages.running import PipelineRun
from calibration.pipeline.system import Exports, System
from calibration.robot.exports import exported

EXPORTS_FOLDER = "exports"
CALIBRATION_FILE = "calibration.json"


@result
class ExportedCalibration:
    """Complete calibration of a system, for programs."""

    schema: Literal[1] = field("Version of this format.")
    system: str = field("The system.")
    verdict: Verdict = field("Of its first cell that passed.")
    truth_mm: float | None = field("The worst error of a sensor against the truth, where that is known.", unit="mm")
    calibration: CalibrationDocument = field("Transforms, parameters, error bars, noise, hash of the labels, engine.")


def export_stage(run: PipelineRun) -> PipelineRun:
    """Write the exports of each system all of whose cells passed.

    A failed export is a reason of the verdict.

    Raises:
        InfrastructureError: a file cannot be written.
    """
    found = tuple(
        _export_system(
            system, system.exports, [cell for cell in run.results.cells if cell.system == system.name], run.output
        )
        for system in run.matrix.systems
        if system.exports is not None
    )
    return replace(run, results=replace(run.results, exports=tuple(each for each in found if each)))


def _export_system(system: System, exports: Exports, cells: Sequence[CellResult], output: Path) -> Exported | None:
    """Export a system; None if it has not passed."""
    if not cells or not all(cell.passes for cell in cells) or cells[0].dataset is None:
        return None
    first = cells[0]
    folder = str(Path(first.dataset or "").parent / EXPORTS_FOLDER)
    try:
        files, notes = files_for_robot(calibrated_dataset(system, first, output), exports, first, output)
    except CalibrationError as error:
        return Exported(system=system.name, folder=folder, reasons=(f"{system.name}: exports: {error}",))
    for name, content in files.items():
        write_atomically(output / folder / name, content)
    notes += [f"undecided: {line}" for line in dict.fromkeys(line for cell in cells for line in cell.undecided)]
    return Exported(system=system.name, folder=folder, files=tuple(sorted(files)), notes=tuple(notes))


def calibrated_dataset(system: System, cell: CellResult, output: Path) -> Dataset:
    """Read the calibrated dataset of a cell, which has one.

    Raises:
        InputError: it cannot be read.
    """
    # The labels' data files stay beside the dataset that was calibrated.
    folder = system.dataset if system.dataset.is_dir() else system.dataset.parent
    return read_dataset(output / (cell.dataset or ""), data=folder, given=system.dataset)


def files_for_robot(
    dataset: Dataset, exports: Exports, cell: CellResult, output: Path
) -> tuple[dict[str, bytes], list[str]]:
    """Return the exports of a cell by name, `CALIBRATION_FILE` among them, and notes for the user.

    Args:
        dataset: its calibrated dataset.
        exports: formats and description.
        cell: its result.
        output: the output folder of the run.

    Raises:
        InputError: the description does not match, or the dataset does not support a format.
    """
    files, notes = exported(dataset, exports.formats, exports.robot_description, exports.xacro)
    details = cell.details or own_details(cell, output)
    if details is not None and details.snapshot is not None:
        truth = cell.truth.translation_mm if cell.truth else None
        document = ExportedCalibration(1, cell.system, cell.verdict, truth, details.snapshot)
        files[CALIBRATION_FILE] = text_of(document).encode()
    return files, notes
