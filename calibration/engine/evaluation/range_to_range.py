"""Agreement of LiDARs and depth cameras with each other, by their points on a pattern.

ATOM's evaluations ``lidar_to_lidar`` (metres: each of the target's points on the pattern against the nearest
of the source's), ``lidar_to_depth`` and ``depth_to_depth`` (pixels: the source's border points in the target's
depth image, each against the nearest of the target's border pixels); each in one collection or between two.
A point is compared with a sample of the other sensor, so exact transforms still give an error. Two scan lines of 2D
LiDARs lie apart on the pattern, and most points of a 3D LiDAR are far from a scan line: neither distance measures the
transforms. So the points of a 2D LiDAR are compared with those of a 3D one, never the other way round.
"""

from collections.abc import Callable

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset, PointLabels, Sensor
from calibration.engine.evaluation.pairing import Pairs, between_collections, same_collection
from calibration.engine.evaluation.selection import depth_of, lidar3d_of, lidar_of, pattern_of
from calibration.engine.evaluation.table import COLLECTION_HEADER, COLLECTION_PAIR, Table
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.nearest import nearest
from calibration.engine.geometry.transforms import apply

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
    difference: Array = moved[nearest(target.points, moved)] - target.points
    return difference


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
        difference: Array = border[nearest(pixels, border)] - pixels
        return difference

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
    source, target = (_point_views(dataset, sensor, pattern) for sensor in sensors)
    if between:
        pairs = between_collections(dataset, sensors, pattern_of(dataset, pattern), (list(source), list(target)))
    else:
        pairs = same_collection(dataset, *sensors, [i for i in source if i in target])
    labels, rows, left_out = [], [], []
    for i, j, T, name in _named_pairs(dataset, pairs, paired=bool(between)):
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


def _named_pairs(dataset: Dataset, pairs: Pairs, *, paired: bool) -> list[tuple[int, int, Array, str]]:
    keys = dataset.keys
    return [
        (i, j, T, f"{keys[i]}-{keys[j]}" if paired else keys[i])
        for i, j, T in zip(pairs.source.tolist(), pairs.target.tolist(), pairs.T_target_source, strict=True)
    ]


def _point_views(dataset: Dataset, sensor: Sensor, pattern: str | None) -> dict[int, PointLabels]:
    seen = dataset.detections(pattern_of(dataset, pattern).name, sensor.name)
    return {i: label for i, label in seen if isinstance(label, PointLabels) and len(label.points)}
