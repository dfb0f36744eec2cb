"""Stage export: files for the robot of each system that passed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calibration.base.errors import CalibrationError
from calibration.base.files import write_atomically
from calibration.base.records import field, result, text_of
from calibration.ci.report import Verdict
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.dataset.reading import read_dataset
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import Exported, own_details
from calibration.pipeline.stages.running import PipelineRun
from calibration.pipeline.system import Exports, System
from calibration.robot.exports.formats import exported

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
        # The labels' data files stay beside the dataset that was calibrated.
        dataset = read_dataset(output / (first.dataset or ""), data=_dataset_folder(system), given=system.dataset)
        files, notes = exported(dataset, exports.formats, exports.robot_description, exports.xacro)
        details = first.details or own_details(first, output)
    except CalibrationError as error:
        return Exported(system=system.name, folder=folder, reasons=(f"{system.name}: exports: {error}",))
    if details is not None and details.snapshot is not None:
        truth = first.truth.translation_mm if first.truth else None
        document = ExportedCalibration(1, system.name, first.verdict, truth, details.snapshot)
        files[CALIBRATION_FILE] = text_of(document).encode()
    for name, content in files.items():
        write_atomically(output / folder / name, content)
    notes += [f"undecided: {line}" for line in dict.fromkeys(line for cell in cells for line in cell.undecided)]
    return Exported(system=system.name, folder=folder, files=tuple(sorted(files)), notes=tuple(notes))


def _dataset_folder(system: System) -> Path:
    return system.dataset if system.dataset.is_dir() else system.dataset.parent
