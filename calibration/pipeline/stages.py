"""Stages of the pipeline but collect: each takes a run, and returns it with its results."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calibration.base import CalibrationError, InfrastructureError, shorten, write_atomically
from calibration.base.records import field, result, text_of
from calibration.ci.report import Verdict
from calibration.ci.workflow.streams import progress
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.pipeline.baselines import commit_of_run, with_accepted
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.matrix import judge_results, run_matrix
from calibration.pipeline.results import Exported, ImageResult, own_details, results_of
from calibration.pipeline.running import PipelineRun
from calibration.pipeline.system import Exports, System
from calibration.robot.exports import exported


def build_stage(run: PipelineRun) -> PipelineRun:
    """Find the image, or build it, push it if specified, and use it for containers that name no other.

    Raises:
        InputError: the specification, or a file that it names, is wrong.
        InfrastructureError: there is no engine, or a registry does not answer.
        CalibrationError: a step of the build failed (exit code 1).
    """
    if run.image is None:
        return run
    from calibration.ci.image.building import build_image  # needs the engine's SDK, as no other stage does

    built = build_image(run.image, run.runner, leave_out=[run.output])  # it changes with every run
    image = ImageResult(built.reference, built.key, built.built, built.digest, round(built.seconds, 4))
    systems = tuple(
        replace(system, software=system.software and system.software.with_image(image.reference))
        for system in run.matrix.systems
    )
    simulations = tuple(
        replace(each, applications=each.applications.with_image(image.reference)) for each in run.simulations
    )
    matrix, results = replace(run.matrix, systems=systems), replace(run.results, image=image)
    return replace(run, matrix=matrix, simulations=simulations, results=results)


def promote_stage(run: PipelineRun) -> PipelineRun:
    """Give the tested image its release tags, if the verdict is pass; nothing is built or pulled.

    Raises:
        InfrastructureError: the registry does not answer, or the image was not pushed.
    """
    specification, image = run.image, run.results.image
    if specification is None or image is None or not run.results.passes:
        run.runner.log(f"not promoted: the verdict is {run.results.verdict}")
        return run
    if run.runner.pull_request:
        run.runner.log("not promoted: a pull request is not merged yet")
        return run
    if image.digest is None:
        raise InfrastructureError(
            f"image.promote: {image.reference} is in no registry; add push: true to the section image"
        )
    from calibration.ci.registries.push import promote
    from calibration.ci.registries.registry import registry_login  # these need the engine's SDK

    credentials = registry_login(specification.registry, specification.name, run.runner)
    promoted = promote(specification.name, image.digest, specification.promote, credentials, run.runner)
    return replace(run, results=replace(run.results, image=replace(image, promoted=tuple(promoted))))


MAX_REASON_CHARACTERS = 200
"""Limit of characters of a reason in the log's line of a cell; all of it stands in the results."""


def calibrate_stage(run: PipelineRun) -> PipelineRun:
    """Calibrate every cell, which passes if it converged, and write tables and datasets into the output folder.

    Raises:
        InputError: a dataset, an evaluation, a truth or the baseline is wrong.
        InfrastructureError: a file cannot be written, a process died, or there is no engine.
    """
    matrix, update = run.matrix, None
    if run.baseline is not None:
        matrix, update = with_accepted(run.matrix, run.baseline, os.environ)
    with progress(run.runner, run.title, bar=not run.matrix.software) as advance:

        def done(count: int, total: int, cell: CellResult) -> None:
            advance(count, total, _cell_line(cell), important=not cell.passes)

        found = run_matrix(matrix, run.output, run.jobs, run.fail_fast, done, run.target)
    commit = commit_of_run(run.config.parent if run.config else Path(), os.environ)
    results = replace(run.results, cells=found.cells, comparisons=found.comparisons, baseline=update, commit=commit)
    return replace(run, results=results, given=found.datasets)


def _cell_line(cell: CellResult) -> str:
    rms = "" if cell.rms_px is None else f", {cell.rms_px:.4f} px"
    why = f"no result: {shorten('; '.join(cell.reasons), MAX_REASON_CHARACTERS)}"
    converged = "calibrated" if cell.converged else "not converged" if cell.error is None else why
    method = "" if cell.by_other_method else f", {cell.method}"  # named in the cell's name
    return f"{cell.name}{method}: {converged}{rms} ({cell.seconds:.2f} s)"


def introspect_stage(run: PipelineRun) -> PipelineRun:
    """Judge the tables in the output folder by each system's rules and limits.

    If this run has calibrated no cell, the results are read from the output folder, except for this run's image.

    Raises:
        InputError: there are no results, or a rule does not match a table.
    """
    systems = run.matrix.systems
    names = {system.name for system in systems}
    found = run.results if run.results.cells else results_of(run.output)
    asked = replace(
        found,
        cells=tuple(cell for cell in found.cells if cell.system in names),
        comparisons=tuple(cell for cell in found.comparisons if cell.system in names),
        image=run.results.image,
    )
    return replace(run, results=judge_results(asked, systems, run.output))


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
    exports = tuple(found for system in run.matrix.systems if (found := _export_system(system, run)))
    return replace(run, results=replace(run.results, exports=exports))


def _export_system(system: System, run: PipelineRun) -> Exported | None:
    """Export a system; None if it has no exports, or has not passed."""
    cells, exports = [cell for cell in run.results.cells if cell.system == system.name], system.exports
    if exports is None or not cells or not all(cell.passes for cell in cells) or cells[0].dataset is None:
        return None
    first = cells[0]
    folder = str(Path(cells[0].dataset).parent / EXPORTS_FOLDER)
    try:
        files, notes = files_for_robot(calibrated_dataset(system, first, run.output), exports, first, run.output)
    except CalibrationError as error:
        return Exported(system=system.name, folder=folder, reasons=(f"{system.name}: exports: {error}",))
    for name, content in files.items():
        write_atomically(run.output / folder / name, content)
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
