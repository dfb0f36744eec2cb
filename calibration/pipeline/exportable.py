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
    if cell is None and ROUGH in dataset.document["_metadata"]:
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
