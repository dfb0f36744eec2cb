"""Reprojection error of a calibration by collection."""

import numpy as np

from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.evaluation.table import Table

REPROJECTION_COLUMNS = ("RMS (pix)",)
COLLECTION_HEADER = "Collection #"


def reprojection(calibration: Calibration) -> Table:
    """Return the root mean square of the reprojection errors of all cameras in each collection (px).

    Raises:
        InputError: no camera has labels.
    """
    squares: dict[str, list[float]] = {}
    for view in calibration.residuals:
        if view.kind == "pixel":
            for key, errors in zip(view.collections, view.magnitudes, strict=True):
                squares.setdefault(key, []).extend((errors[np.isfinite(errors)] ** 2).tolist())
    if not squares:
        raise InputError(
            f"{calibration.dataset.path}: no camera has labels, so there are no reprojection errors: choose "
            f"another table (evaluate), such as {_other_table(calibration.dataset)}"
        )
    keys = sorted(squares, key=int)
    return Table(
        COLLECTION_HEADER,
        REPROJECTION_COLUMNS,
        tuple(keys),
        np.array([[np.sqrt(np.mean(squares[key]))] for key in keys]),
    )


def _other_table(dataset: Dataset) -> str:
    """Name a table for a dataset without cameras."""
    tracker = next((name for name, sensor in dataset.sensors.items() if sensor.modality.family == "tracker"), None)
    return f"measured-poses:{tracker}" if tracker else "lidar-to-lidar:SOURCE:TARGET"
