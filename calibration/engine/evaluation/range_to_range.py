"""Brute-force nearest neighbours for a few thousand points."""

from collections.abc import Callable

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset, PointLabels, Sensor
from calibration.engine.evaluation.table import COLLECTION_HEADER, COLLECTION_PAIR, Table
from calibration.engine.evaluation.views import (
    between_collections,
    depth_of,
    lidar3d_of,
    lidar_of,
    pattern_of,
    point_views,
    same_collection,
)
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply

_CHUNK = 1 << 20  # chunk size (number of distances), to bound the memory


def nearest(points: Array, among: Array) -> IntArray:
    """Return the index (N,) of the point in `among` (M, D), M > 0, nearest to each of `points` (N, D)."""
    centre = among.mean(0)  # centred, because the expanded square loses digits far from the origin
    rest = among - centre
    squares = (rest * rest).sum(-1)
    found = np.empty(len(points), int)
    step = max(1, _CHUNK // len(among))
    for start in range(0, len(points), step):
        part = points[start : start + step] - centre
        found[start : start + step] = (squares - 2 * part @ rest.T).argmin(-1)
    return found


RANGE_COLUMNS = ("RMS", "X err", "Y err", "X StDev", "Y StDev")
"""Column headers, with the unit."""
IMAGE_MARGIN = 0.025
"""Margin as a fraction of the image size: points in it are ignored, the pattern may exceed the image."""

Errors = Callable[[PointLabels, PointLabels, Array], Array]
"""From the labels of source and target and T_target_source: differences (K, 2 or 3), possibly empty."""


def lidar_to_lidar(
    dataset: Dataset, source: str, target: str, pattern: str | None = None, *, between: bool = False
) -> Table:
    """Errors between the points of two LiDARs on the pattern.

    Columns (m), in the target's frame: the root of the mean squared distance; the mean absolute difference along
    x and y, and its standard deviation.

    Args:
        dataset: the transforms to evaluate.
        source: the LiDAR whose points are transformed; a 3D one.
        target: the LiDAR, 3D or 2D, whose points are compared with them.
        pattern: its name; None if there is only one.
        between: compare every collection of the source with every one of the target, for a fixed pattern.

    Raises:
        InputError: no such sensor or pattern, a transform is missing, the sensors have no common view, or the
            pattern moves between the compared collections.
    """
    sensors = lidar3d_of(dataset, source), lidar_of(dataset, target)
    return _range_table(dataset, sensors, pattern, _in_space, "m", between=COLLECTION_PAIR if between else None)


def lidar_to_depth(
    dataset: Dataset, source: str, target: str, pattern: str | None = None, *, between: bool = False
) -> Table:
    """Return the errors of a LiDAR's border points in a depth image (px); arguments and errors as `lidar_to_lidar`."""
    depth, camera = depth_of(dataset, target)
    sensors = lidar_of(dataset, source), depth
    return _range_table(
        dataset, sensors, pattern, _in_image(camera), "pix", between=COLLECTION_HEADER if between else None
    )


def depth_to_depth(
    dataset: Dataset, source: str, target: str, pattern: str | None = None, *, between: bool = False
) -> Table:
    """Return the errors of a depth camera's border points in the image of another, as `lidar_to_depth`."""
    depth, camera = depth_of(dataset, target)
    sensors = depth_of(dataset, source)[0], depth
    return _range_table(
        dataset, sensors, pattern, _in_image(camera), "pix", between=COLLECTION_HEADER if between else None
    )


def _in_space(source: PointLabels, target: PointLabels, T_target_source: Array) -> Array:
    moved = apply(T_target_source, source.points)
    return moved[nearest(target.points, moved)] - target.points


def _in_image(camera: Camera) -> Errors:
    low = np.array([camera.width, camera.height]) * IMAGE_MARGIN
    high = np.array([camera.width, camera.height]) * (1 - IMAGE_MARGIN)

    def errors(source: PointLabels, target: PointLabels, T_target_source: Array) -> Array:
        if not len(target.limits):
            return np.empty((0, 2))
        border = np.rint(camera.project(target.points[target.limits]))  # labels are integer pixels
        pixels, visible = camera.project_visible(apply(T_target_source, source.points[source.limits]))
        with np.errstate(invalid="ignore"):
            pixels = pixels[visible & ((pixels >= low) & (pixels <= high)).all(-1)]
        return border[nearest(pixels, border)] - pixels

    return errors


def _range_table(
    dataset: Dataset,
    sensors: tuple[Sensor, Sensor],
    pattern: str | None,
    errors: Errors,
    unit: str,
    *,
    between: str | None,
) -> Table:
    """Return the table within each collection, or for all pairs of collections with `between` as the labels' header."""
    source, target = (point_views(dataset, sensor, pattern_of(dataset, pattern)) for sensor in sensors)
    if between:
        pairs = between_collections(dataset, sensors, pattern_of(dataset, pattern), (list(source), list(target)))
    else:
        pairs = same_collection(dataset, *sensors, [i for i in source if i in target])
    labels, rows, left_out = [], [], []
    for i, j, T, name in zip(
        pairs.source.tolist(), pairs.target.tolist(), pairs.T_target_source, pairs.names, strict=True
    ):
        difference = errors(source[i], target[j], T)
        if len(difference):
            labels.append(name)
            absolute = np.abs(difference[:, :2])
            rms = np.sqrt((difference * difference).sum(-1).mean())
            rows.append([rms, *absolute.mean(0), *absolute.std(0)])
        else:
            left_out.append(
                f"{name}: no border point of {sensors[0].name} is on the image beside one of {sensors[1].name}"
            )
    if not rows:
        counts = ", ".join(f"'{s.name}' has {len(v)} views" for s, v in zip(sensors, (source, target), strict=True))
        raise InputError(f"{dataset.path}: nothing seen by both: {counts}" + "".join(f"; {s}" for s in left_out[:3]))
    columns = tuple(f"{column} ({unit})" for column in RANGE_COLUMNS)
    return Table(between or COLLECTION_HEADER, columns, tuple(labels), np.array(rows), tuple(left_out))
