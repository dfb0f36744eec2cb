"""Checks of a dataset before any calibration, for faults that would make the least squares meaningless."""

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.board_order import check_board_order
from calibration.engine.diagnosis.copies import check_copies
from calibration.engine.diagnosis.units import check_units


def check_data(dataset: Dataset) -> None:
    """Refuse data that would calibrate to nonsense; `calibration.engine.dataset.reading` has checked the form.

    Raises:
        InputError: lengths look like millimetres, angles like degrees, the corners are not numbered as in the
            dataset's patterns, or collections are copies of others.
    """
    check_units(dataset)
    check_board_order(dataset)
    check_copies(dataset)
