"""Agreement of a LiDAR or a depth camera with a camera: points on the pattern's border, projected into the image.

ATOM's evaluations ``lidar_to_rgb`` and ``depth_to_rgb``: the limit points are projected into the image, and
each is compared with the nearest point on the lines of the border's annotation (in ATOM with the nearest
of its points); also between collections.
"""

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset, PointLabels, Sensor
from calibration.engine.evaluation.annotation import Annotation
from calibration.engine.evaluation.pairing import Pairs, between_collections, same_collection
from calibration.engine.evaluation.selection import camera_of, depth_of, lidar_of, pattern_of
from calibration.engine.evaluation.table import COLLECTION_HEADER, COLLECTION_PAIR, Table
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply

RANGE_TO_RGB_COLUMNS = ("RMS (pix)", "X err (pix)", "Y err (pix)")


def lidar_to_rgb(
    dataset: Dataset, lidar: str, camera: str, annotation: Annotation, pattern: str | None = None
) -> Table:
    """Return the errors of the LiDAR's border points in each annotated collection.

    Columns, over the points inside the image: the root of the mean squared distance, the mean
    absolute error along x and y (px).

    Args:
        dataset: the transforms to evaluate.
        lidar: the LiDAR.
        camera: the camera.
        annotation: the pattern's border in the images.
        pattern: its name; None if there is only one.

    Raises:
        InputError: no such sensor or pattern, a transform is missing, or no collection has both
            border points on the image and an annotation.
    """
    return _table_of_collections(dataset, lidar_of(dataset, lidar), camera, annotation, pattern)


def depth_to_rgb(
    dataset: Dataset, depth: str, camera: str, annotation: Annotation, pattern: str | None = None
) -> Table:
    """Return `lidar_to_rgb` for the border points of a depth camera."""
    return _table_of_collections(dataset, depth_of(dataset, depth)[0], camera, annotation, pattern)


def inter_collection_lidar_to_rgb(
    dataset: Dataset, lidar: str, camera: str, annotation: Annotation, pattern: str | None = None
) -> Table:
    """Return `lidar_to_rgb` for the border points of one collection in the image of another, for a fixed pattern.

    There is a row for every pair, labelled with the camera's collection first, as in ATOM.

    Raises:
        InputError: also when the pattern is not fixed.
    """
    return _table_of_pairs(
        dataset, lidar_of(dataset, lidar), camera, annotation, pattern, key=COLLECTION_PAIR, camera_first=True
    )


def inter_collection_depth_to_rgb(
    dataset: Dataset, depth: str, camera: str, annotation: Annotation, pattern: str | None = None
) -> Table:
    """Return `inter_collection_lidar_to_rgb` for a depth camera; its collection is first in the labels."""
    sensor, _ = depth_of(dataset, depth)
    return _table_of_pairs(dataset, sensor, camera, annotation, pattern, key=COLLECTION_HEADER, camera_first=False)


def _table_of_collections(
    dataset: Dataset, sensor: Sensor, camera: str, annotation: Annotation, pattern: str | None
) -> Table:
    camera_sensor, intrinsics = camera_of(dataset, camera)
    views = _point_views(dataset, sensor, pattern)
    pairs = same_collection(dataset, sensor, camera_sensor, list(views))
    labels = [dataset.keys[i] for i in pairs.source]
    return _range_to_rgb_table(
        dataset, (sensor, camera_sensor, intrinsics), views, annotation, pairs, labels, COLLECTION_HEADER
    )


def _table_of_pairs(
    dataset: Dataset,
    sensor: Sensor,
    camera: str,
    annotation: Annotation,
    pattern: str | None,
    *,
    key: str,
    camera_first: bool,
) -> Table:
    camera_sensor, intrinsics = camera_of(dataset, camera)
    views = _point_views(dataset, sensor, pattern)
    annotated = [i for i, name in enumerate(dataset.keys) if len(annotation.get(name, ()))]
    pairs = between_collections(
        dataset, (sensor, camera_sensor), pattern_of(dataset, pattern), (list(views), annotated)
    )
    first, second = (pairs.target, pairs.source) if camera_first else (pairs.source, pairs.target)
    order = np.lexsort((second, first))
    pairs = Pairs(pairs.source[order], pairs.target[order], pairs.T_target_source[order])
    labels = [f"{dataset.keys[a]}-{dataset.keys[b]}" for a, b in zip(first[order], second[order], strict=True)]
    return _range_to_rgb_table(dataset, (sensor, camera_sensor, intrinsics), views, annotation, pairs, labels, key)


def _point_views(dataset: Dataset, sensor: Sensor, pattern: str | None) -> dict[int, PointLabels]:
    seen = dataset.detections(pattern_of(dataset, pattern).name, sensor.name)
    return {i: label for i, label in seen if isinstance(label, PointLabels)}


def _range_to_rgb_table(
    dataset: Dataset,
    sensors: tuple[Sensor, Sensor, Camera],
    views: dict[int, PointLabels],
    annotation: Annotation,
    pairs: Pairs,
    names: list[str],
    key: str,
) -> Table:
    sensor, camera, intrinsics = sensors
    labels, rows, left_out = [], [], []
    for i, j, T, name in zip(pairs.source.tolist(), pairs.target.tolist(), pairs.T_target_source, names, strict=True):
        segments = annotation.get(dataset.keys[j], np.empty((0, 2, 2)))
        pixels, visible = intrinsics.project_visible(apply(T, views[i].points[views[i].limits]))
        with np.errstate(invalid="ignore"):
            pixels = pixels[visible & intrinsics.contains(pixels)]
        if not len(segments):
            left_out.append(f"{name}: the pattern's border is not annotated")
        elif not len(pixels):
            left_out.append(
                f"{name}: none of the {len(views[i].limits)} border points of {sensor.name} is on the image"
            )
        else:
            error = _nearest_on_segments(pixels, segments) - pixels
            labels.append(name)
            rows.append([np.sqrt((error * error).sum(-1).mean()), *np.abs(error).mean(0)])
    if not rows:
        raise InputError(
            f"{dataset.path}: no collection shows border points of '{sensor.name}' in an annotated image of "
            f"'{camera.name}'" + "".join(f"; {line}" for line in left_out[:3])
        )
    return Table(key, RANGE_TO_RGB_COLUMNS, tuple(labels), np.array(rows), tuple(left_out))


def _nearest_on_segments(points: Array, segments: Array) -> Array:
    """Return the point on any of the segments (S, 2, 2) nearest to each of the points (N, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length2 = np.maximum((along * along).sum(-1), 1e-12)
    share = np.clip(((points[:, None] - start) * along).sum(-1) / length2, 0, 1)
    feet = start + share[..., None] * along  # (N, S, 2)
    away = feet - points[:, None]
    best = (away * away).sum(-1).argmin(-1)
    nearest: Array = feet[np.arange(len(points)), best]
    return nearest
