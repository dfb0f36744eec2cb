"""Checks of a dataset that need no calibration: what no least squares should be asked."""

from calibration.dataset.model import Dataset
from calibration.diagnosis.copies import check_copies
from calibration.diagnosis.units import check_units


def check_data(dataset: Dataset) -> None:
    """Refuse data that would calibrate to nonsense; `calibration.dataset.reading` has refused what is no dataset.

    Raises:
        InputError: lengths look like millimetres, angles like degrees, or collections are copies of others.
    """
    check_units(dataset)
    check_copies(dataset)
