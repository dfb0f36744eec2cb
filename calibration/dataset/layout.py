"""Patterns whose columns and rows are exchanged, told by the ids of the corners that a camera saw."""

import numpy as np

from calibration.dataset.document import Node
from calibration.dataset.model import CornerLabels, Dataset
from calibration.dataset.pattern import Pattern
from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array

LEAST_CORNERS = 12
"""Of fewer corners an exchange is not told from an error of a detector."""
MISFIT = 0.1
"""A view that misses a flat pattern by more, as a share of its extent, is not of this pattern."""
BETTER = 0.2
"""A layout that misses by less than this share of the other's is the right one."""


def check_layouts(dataset: Dataset, root: Node) -> None:
    """Refuse a pattern of which ``dimension`` has x for y: its corners are numbered by rows of another length.

    Raises:
        InputError: the view with the most corners fits the exchanged layout alone.
    """
    for name, pattern in dataset.patterns.items():
        columns = int((abs(pattern.corners[:, 1] - pattern.corners[0, 1]) < 1e-9).sum())
        rows = len(pattern.corners) // columns
        view = max(_views(dataset, name), key=lambda view: len(view[0].ids), default=None)
        if rows in (1, columns) or rows * columns != len(pattern.corners) or view is None:
            continue
        labels, camera = view
        if len(labels.ids) < LEAST_CORNERS:
            continue
        xy = camera.normalise(labels.pixels)
        misfit = _misfit(pattern.corners[labels.ids, :2], xy)
        if misfit > MISFIT and _misfit(_exchanged(pattern, columns)[labels.ids], xy) < BETTER * misfit:
            config = root["calibration_config"]
            several = config.get("calibration_patterns")
            dimension = (several[name] if several else config["calibration_pattern"])["dimension"]
            raise dimension.fault(
                f"found x: {columns}, y: {rows}, but the labels are numbered by rows of {rows} corners; expected "
                f"x: {rows}, y: {columns} (x counts the corners of a row)"
            )


def _views(dataset: Dataset, pattern: str) -> list[tuple[CornerLabels, Camera]]:
    return [
        (labels, camera)
        for collection in dataset.collections
        for (name, sensor), labels in collection.labels.items()
        if name == pattern and isinstance(labels, CornerLabels) and (camera := dataset.sensors[sensor].camera)
    ]


def _exchanged(pattern: Pattern, columns: int) -> Array:
    """(K, 2): the corners by id if the pattern had as many columns as it has rows."""
    rows = len(pattern.corners) // columns
    row, column = np.divmod(np.arange(len(pattern.corners)), rows)
    return np.stack([column, row], -1).astype(float)


def _misfit(plane: Array, image: Array) -> float:
    """How far points (K, 2) of a plane lie from their images (K, 2) under the best homography, by the images' extent.

    The linear solution, normalised: R. Hartley, A. Zisserman, Multiple View Geometry, 2nd edition, 4.1 and 4.4.
    """
    if not np.isfinite(image).all():
        return 0.0
    p, q = ((points - points.mean(0)) / max(points.std(), 1e-12) for points in (plane, image))
    one, zero = np.ones((len(p), 1)), np.zeros((len(p), 3))
    h = np.concatenate([p, one], -1)
    A = np.concatenate([np.concatenate([h, zero, -q[:, :1] * h], -1), np.concatenate([zero, h, -q[:, 1:] * h], -1)])
    H = np.linalg.svd(A)[2][-1].reshape(3, 3)
    x = h @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sqrt(((x[:, :2] / x[:, 2:] - q) ** 2).sum(-1).mean())
    return float(error) if np.isfinite(error) else np.inf
