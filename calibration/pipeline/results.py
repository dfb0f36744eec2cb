"""Results of a pipeline: cells, comparisons, collections, the image; and their file between the stages."""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from calibration.base import CalibrationError, ExitCode, InputError, exit_code_of, shorten
from calibration.base.addons import import_attribute, of_addons
from calibration.base.records import computed, field, result, with_fields
from calibration.ci.report import FILES, RESULTS_FILE, Verdict, read_results_file, remove_results, verdict_of
from calibration.ci.report.blocks import BADGE_FILE as BADGE
from calibration.ci.report.junit import ErrorCode
from calibration.ci.report.report import BRIEF_FILE, StageResult
from calibration.engine.baseline.document import BaselineUpdate
from calibration.engine.dataset.model import ROUGH_KEY, Dataset
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.estimation.problem.intrinsics import FILE_NAME as INTRINSICS
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult, Details

SCHEMA_FILE = Path(__file__).with_name("results.schema.json")
CELLS_FILE = "cells.csv"
PAGE_FILE = "report.html"
_COMMANDS_TEXT = "calibrate-matrix or run"


@result
class Collected:
    """Result of one entry of ``simulation`` in calibration.yml."""

    name: str = field("The entry in calibration.yml.")
    poses: int = field("Poses of the motion.", default=0)
    kept: int = field("Collections in the dataset.", default=0)
    corner_rms_px: float | None = field("Detected corners against the true ones.", unit="px", default=None)
    rms_px: float | None = field("RMS of the dataset's calibration.", unit="px", default=None)
    translation_mm: float | None = field(
        "The worst translation error of a calibrated sensor against the truth.", unit="mm", default=None
    )
    rotation_deg: float | None = field(
        "The worst rotation error of a calibrated sensor against the truth.", unit="deg", default=None
    )
    dataset: str | None = field("Its folder, relative to the output folder.", default=None)
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())
    error: ErrorCode | None = field("Exit code of a collection that could not be made.", default=None)
    seconds: float = field("Duration.", default=0.0)

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason or an error."""
        return verdict_of(not self.reasons and self.error is None)


@result
class ImageResult:
    """Image of the team's software."""

    reference: str = field("Reference of the containers' image.")
    key: str = field("The content key, a hash of everything that goes into the image.")
    built: bool = field("False if it was found, and nothing was built.")
    digest: str | None = field("In the registry; null if it was not pushed.", default=None)
    seconds: float = field("Duration.", default=0.0)
    promoted: tuple[str, ...] = field("The tags that it got because the verdict was pass.", default=())


@result(kw_only=True)
class Exported:
    """Exported files of a system."""

    system: str = field("The system.")
    folder: str = field("The folder, relative to the output folder.")
    files: tuple[str, ...] = field("The files in it.", default=())
    notes: tuple[str, ...] = field(
        "Formats that its data cannot have, transforms that moved to another joint.", default=()
    )
    reasons: tuple[str, ...] = field("Reason why it could not be exported.", default=())


@result
@with_fields(
    {
        stage.section: (
            import_attribute(stage.result.record) | None,
            field(stage.result.help, default=None, omitted=True),
        )
        for stage in of_addons(lambda addon: addon.stages).values()
    }
)
class StageResults:
    """Results of the stages of add-ons, by their sections of calibration.yml."""

    @property
    def all(self) -> tuple[StageResult, ...]:
        """Results of the stages that ran."""
        return tuple(found for found in vars(self).values() if found is not None)


@result
class CommitOfRun:
    """Commit that was tested."""

    hash: str = field("Its hash; of a pull request, that of its branch.")
    date: str = field("Of the checked-out commit, YYYY-MM-DD.")

    def __str__(self) -> str:
        return f"{self.hash[:7]} of {self.date}"


@result
class Numbers:
    """Statistics of several cells; the worst is null if no cell has such a number."""

    cells: int = field("Number of cells.")
    passed: int = field("How many passed.")
    converged: int = field("How many converged.")
    success_rate: float = field("Share that passed, 0 to 1.")
    worst_rms_px: float | None = field("The largest RMS.", unit="px")
    worst_translation_mm: float | None = field("The largest error against the truth.", unit="mm")
    worst_rotation_deg: float | None = field("The largest error against the truth.", unit="deg")
    undecided: int = field("How many are undecided, whether that counts as passed or not.", default=0)

    @classmethod
    def of(cls, cells: Sequence[CellResult]) -> "Numbers":
        """Return the statistics of these cells."""

        def worst(values: Iterable[float | None]) -> float | None:
            known = [v for v in values if v is not None]
            return max(known) if known and all(math.isfinite(v) for v in known) else None

        passed, truths = sum(cell.passes for cell in cells), [cell.truth for cell in cells if cell.truth]
        return cls(
            len(cells),
            passed,
            sum(cell.converged for cell in cells),
            round(passed / len(cells), 6) if cells else 0.0,
            worst(cell.rms_px for cell in cells),
            worst(truth.translation_mm for truth in truths),
            worst(truth.rotation_deg for truth in truths),
            sum(cell.verdict == "undecided" for cell in cells),
        )


@result
class Summary:
    """Statistics of all cells, and of each system."""

    all: Numbers = field(flat=True)
    systems: Mapping[str, Numbers] = field("By system.")


@result
class PipelineResults:
    """Results of a pipeline: cells of a matrix, comparison methods on the same data, collections, the image."""

    cells: tuple[CellResult, ...] = field("The cells of the matrix.", default=())
    comparisons: tuple[CellResult, ...] = field(
        "Other methods on the same data, and our engine on the cells of a team's software; they have no part in the "
        "verdict.",
        default=(),
    )
    collections: tuple[Collected, ...] = field("Simulated datasets.", default=())
    image: ImageResult | None = field("Image with the team's software, if there is one.", default=None)
    baseline: BaselineUpdate | None = field(
        "The file of accepted calibrations, and what the change under test does to it.", default=None, omitted=True
    )
    exports: tuple[Exported, ...] = field("Exports of the systems that passed.", default=())
    of_stages: StageResults = field(flat=True, default_factory=StageResults)
    commit: CommitOfRun | None = field("The commit that was tested, in a checkout.", default=None, omitted=True)

    @property
    @computed()
    def summary(self) -> Summary:
        """Statistics of all cells, and of each system."""
        by_system = {s: Numbers.of([c for c in self.cells if c.system == s]) for s in self.systems}
        return Summary(Numbers.of(self.cells), by_system)

    @property
    def without_details(self) -> "PipelineResults":
        """Return the results without the details in the cells' own results."""
        return self.with_each_cell(lambda cell: replace(cell, details=None))

    def with_each_cell(self, change: Callable[[CellResult], CellResult]) -> "PipelineResults":
        """Return the results with each cell and comparison changed."""
        return replace(self, cells=tuple(map(change, self.cells)), comparisons=tuple(map(change, self.comparisons)))

    @property
    def judged(self) -> tuple[CellResult | Collected, ...]:
        """Results that count for the verdict."""
        return (*self.cells, *self.collections)

    @property
    def has_verdict(self) -> bool:
        """Whether a cell, a collection or a stage of an add-on was judged."""
        return bool(self.judged or self.of_stages.all)

    @property
    def verdict(self) -> Verdict:
        """Pass if all cells and collections passed; without any, if an image was built or a stage of an add-on ran.

        Undecided if a cell is, and nothing failed.
        """
        found = self.has_verdict or self.image is not None
        comparable = self.baseline is None or not self.baseline.reasons
        whole = comparable and not any(each.reasons for each in self.exports)
        whole = whole and not any(each.reasons for each in self.of_stages.all)
        if not found or not whole or any(each.verdict == "fail" for each in self.judged):
            return "fail"
        return "undecided" if any(each.verdict == "undecided" for each in self.judged) else "pass"

    @property
    def passes(self) -> bool:
        """Whether the verdict is pass, or undecided only in cells where that counts as passed."""
        return self.verdict != "fail" and all(cell.passes for cell in self.cells)

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 after bad input or an infrastructure failure, else the verdict's."""
        return exit_code_of(self.passes, (each.error for each in self.judged))

    @property
    def systems(self) -> tuple[str, ...]:
        """The systems, in order."""
        return tuple(dict.fromkeys(cell.system for cell in (*self.cells, *self.comparisons)))


def read_results(folder: Path) -> PipelineResults:
    """Read ``results.json`` in a folder, of this version or an older one.

    Raises:
        InputError: there is none, a value has another type, or a verdict contradicts its own numbers and reasons.
    """
    path = folder / RESULTS_FILE
    results, written = read_results_file(PipelineResults, path, _COMMANDS_TEXT)
    if "cells" not in written:
        expected = "it has no list of cells (of repeated runs name the folder of one: run-1)"
        raise InputError(f"{path}: this is not a results file of {_COMMANDS_TEXT}: {expected}")
    for key in ("cells", "comparisons", "collections"):
        for each, entry in zip(getattr(results, key), written.get(key, ()), strict=True):
            if each.verdict != (stored := entry.get("verdict")):
                raise InputError(f"{path}: {each.name}: found {stored}, which its own numbers and reasons contradict")
    return results


def results_of(output: Path) -> PipelineResults:
    """Read the results in an output folder, with the details from the cells' own files.

    Raises:
        InputError: a file cannot be read.
    """
    return read_results(output).with_each_cell(lambda cell: replace(cell, details=own_details(cell, output)))


def without_verdicts(results: PipelineResults) -> PipelineResults:
    """Return results without verdicts, to judge their cells again."""

    def reset(cell: CellResult) -> CellResult:
        red, undecided = (
            tuple(finding.text for finding in cell.findings if finding.severity == severity)
            for severity in ("red", "undecided")
        )
        return replace(cell, reasons=red if cell.converged else cell.reasons, undecided=undecided)

    return results.with_each_cell(reset)


def own_file(cell: CellResult) -> str | None:
    """Return the path of a cell's own results, relative to the output folder; None if there are none."""
    if cell.method != OUR_METHOD or cell.translation_noise is None or (folder := cell.own_folder) is None:
        return None
    return f"{folder}/{RESULTS_FILE}"


def own_details(cell: CellResult, output: Path) -> Details | None:
    """Return the details in a cell's own results; None if there are none.

    Raises:
        InputError: the file cannot be read.
    """
    file = own_file(cell)
    return (
        None if file is None else read_results_file(PipelineResults, output / file, _COMMANDS_TEXT)[0].cells[0].details
    )


def reason_of_end(error: BaseException) -> str:
    """Return why a run ended early."""
    if isinstance(error, CalibrationError):
        return str(error)
    return error.strerror or str(error) if isinstance(error, OSError) else "it was stopped"


def clear_results(output: Path, inputs: Collection[Path] = ()) -> None:
    """Remove the results of an earlier matrix from the output folder, so that they are not mistaken for new ones.

    Images and point clouds are kept.

    Args:
        output: the folder.
        inputs: files that are still needed.

    Raises:
        InputError: one of the inputs is among the earlier results.
        InfrastructureError: a file cannot be removed.
    """
    try:
        earlier = read_results(output)
    except InputError:
        earlier = PipelineResults()
    names = [*FILES, BRIEF_FILE, PAGE_FILE, CELLS_FILE, BADGE]
    for cell in (*earlier.cells, *earlier.comparisons):
        own = own_file(cell)
        names += [name for name in (cell.table, cell.dataset, own) if name]
        names += [str(Path(own).with_name(INTRINSICS))] if own else []
    names += [f"{each.folder}/{name}" for each in earlier.exports for name in each.files]
    whole = output.resolve()
    inside = {name: file for name in names if (file := (output / name).resolve()).is_relative_to(whole)}
    needed = {path.resolve() for path in inputs}
    for name, file in inside.items():
        if file in needed:
            raise InputError(
                f"{output / name}: this input is an earlier result in the output folder; choose another output"
            )
    remove_results(output, inside)
    for folder in sorted({(output / name).parent for name in inside} - {output}, reverse=True):
        with suppress(OSError):  # it contains other files
            folder.rmdir()


MAX_FOLDERS_ABOVE = 4
"""Number of folders above a dataset in which its run's results are looked for: OUTPUT/SYSTEM/START/dataset.json."""


def refuse_what_has_not_passed(path: Path, dataset: Dataset, cell: CellResult | None) -> None:
    """Refuse a dataset that may not be put on a robot.

    Args:
        path: the dataset's folder or file, for messages.
        dataset: what it contains.
        cell: the result of the cell that wrote it; None if it is not from a run of ours.

    Raises:
        InputError: the cell has not passed; or the dataset was imported, and no run has calibrated it.
    """
    if cell is not None and not cell.passes:
        why = (*cell.reasons, *cell.undecided, "it has not converged")[0]
        raise InputError(
            f"{path}: the verdict of this cell is {cell.verdict} ({shorten(why, 300)}); what has not passed is "
            "exported with --although 'why' only"
        )
    if cell is None and ROUGH_KEY in dataset.document["_metadata"]:
        raise InputError(
            f"{path}: this dataset was imported, and has not been calibrated: its transforms are guesses. Export the "
            "folder of a cell of a run (output/SYSTEM/START); --although 'why' exports it as it is"
        )


def cell_that_wrote(path: Path) -> CellResult | None:
    """Return the cell whose results, beside a dataset's folder or file or in a folder above, name it as theirs."""
    file = path if path.suffix == ".json" else path / FILE_NAME
    for folder in [file.parent, *file.resolve().parents[1 : MAX_FOLDERS_ABOVE + 1]]:
        if not (folder / RESULTS_FILE).is_file():
            continue
        try:
            cells = read_results(folder).cells
        except InputError:  # of another command
            continue
        if folder == file.parent and len(cells) == 1:  # a cell's own results
            return cells[0]
        for cell in cells:
            if cell.dataset is not None and (folder / cell.dataset).resolve() == file.resolve():
                return cell
    return None
