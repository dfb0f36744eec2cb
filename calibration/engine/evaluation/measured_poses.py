"""Errors of measured pattern poses against the poses predicted by a calibration."""

import numpy as np

from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.evaluation.selection import pattern_of, tracker_of
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.evaluation.views import measured_views
from calibration.engine.geometry.transforms import distance

MEASURED_POSE_COLUMNS = ("Translation (mm)", "Rotation (deg)")


def measured_poses(dataset: Dataset, sensor: str, pattern: str | None = None) -> Table:
    """Return the translation and rotation error of each measured pose.

    Args:
        dataset: the transforms to evaluate, including the pattern's.
        sensor: a sensor with poses as labels.
        pattern: its name; None if the dataset has only one.

    Raises:
        InputError: no such sensor or pattern, its labels are no poses, or the dataset has no pose of the pattern.
    """
    found, board = tracker_of(dataset, sensor), pattern_of(dataset, pattern)
    views = measured_views(dataset, sensor, board)
    if not len(views.collections):
        raise InputError(f"{dataset.path}: '{sensor}' measures no pose of '{board.name}'")
    seen = dataset.seen_by(sensor).with_collections(views.collections.tolist())
    off, turned = distance(seen.transform(found.frame, board.link), views.T_camera_pattern)
    return Table(COLLECTION_HEADER, MEASURED_POSE_COLUMNS, seen.keys, np.stack([1e3 * off, np.degrees(turned)], -1))
