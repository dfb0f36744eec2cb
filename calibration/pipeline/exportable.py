"""Whether a calibrated dataset may be put on a robot: by the verdict of the run that wrote it."""

from pathlib import Path

from calibration.base.errors import InputError
from calibration.base.text import shorten
from calibration.ci.report import RESULTS_FILE
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import FILE_NAME
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import read_results
from calibration.robot.importing.document import ROUGH

MAX_FOLDERS_ABOVE = 4
"""Number of folders above a dataset in which its run's results are looked for: OUTPUT/SYSTEM/START/dataset.json."""


def refuse_what_has_not_passed(path: Path, dataset: Dataset) -> CellResult | None:
    """Return the result of the cell that wrote a dataset; None if it is not from a run of ours.

    Args:
        path: the dataset's folder or file.
        dataset: what it contains.

    Raises:
        InputError: the cell has not passed; or the dataset was imported, and no run has calibrated it.
    """
    cell = _cell_that_wrote(path if path.suffix == ".json" else path / FILE_NAME)
    if cell is not None and not cell.passes:
        why = (*cell.reasons, *cell.undecided, "it has not converged")[0]
        raise InputError(
            f"{path}: the verdict of this cell is {cell.verdict} ({shorten(why, 300)}); what has not passed is "
            "exported with --although 'why' only"
        )
    if cell is None and ROUGH in dataset.document["_metadata"]:
        raise InputError(
            f"{path}: this dataset was imported, and has not been calibrated: its transforms are guesses. Export the "
            "folder of a cell of a run (output/SYSTEM/START); --although 'why' exports it as it is"
        )
    return cell


def _cell_that_wrote(file: Path) -> CellResult | None:
    """Return the cell whose results, beside a dataset or in a folder above, name it as theirs."""
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
