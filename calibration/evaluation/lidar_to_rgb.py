"""How well a LiDAR and a camera agree: points on the pattern's border, seen in the image.

ATOM's evaluation ``lidar_to_rgb``: the limit points of the LiDAR are projected into the image, and
each is compared with the nearest place on the border's annotation (in ATOM the nearest of its
points, here of its lines).
"""

import numpy as np

from calibration.dataset.model import Dataset, PointLabels
from calibration.errors import InputError
from calibration.evaluation.annotation import Annotation
from calibration.evaluation.selection import camera_of, lidar_of, pattern_of
from calibration.evaluation.table import Table
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array

COLUMNS = ("RMS (pix)", "X err (pix)", "Y err (pix)")
KEY = "Collection #"


def lidar_to_rgb(
    dataset: Dataset, lidar: str, camera: str, annotation: Annotation, pattern: str | None = None
) -> Table:
    """Errors of the LiDAR's border points in each annotated collection.

    Columns, over the points that fall on the image: the root of the mean squared distance, the mean
    absolute error along x and y (px).

    Args:
        dataset: with the transforms to evaluate.
        lidar: the LiDAR.
        camera: the camera.
        annotation: the pattern's border in the images.
        pattern: which one; None where there is only one.

    Raises:
        InputError: no such sensor or pattern, a transform is missing, or no collection has both
            border points on the image and an annotation.
    """
    seen_pattern = pattern_of(dataset, pattern)
    lidar_sensor, (camera_sensor, intrinsics) = lidar_of(dataset, lidar), camera_of(dataset, camera)
    detections = [
        (i, label) for i, label in dataset.detections(seen_pattern.name, lidar) if isinstance(label, PointLabels)
    ]
    T_camera_lidar = dataset.with_collections([i for i, _ in detections]).transform(
        camera_sensor.frame, lidar_sensor.frame
    )
    labels, rows, left_out = [], [], []
    for (i, label), T in zip(detections, T_camera_lidar, strict=True):
        key = dataset.keys[i]
        segments = annotation.get(key, np.empty((0, 2, 2)))
        pixels, visible = intrinsics.project_visible(apply(T, label.points[label.limits]))
        with np.errstate(invalid="ignore"):
            pixels = pixels[visible & intrinsics.contains(pixels)]
        if not len(segments):
            left_out.append(f"{key}: the pattern's border is not annotated")
        elif not len(pixels):
            left_out.append(f"{key}: none of the {len(label.limits)} border points of {lidar} is on the image")
        else:
            error = _nearest(pixels, segments) - pixels
            labels.append(key)
            rows.append([np.sqrt((error * error).sum(-1).mean()), *np.abs(error).mean(0)])
    if not rows:
        raise InputError(
            f"{dataset.path}: no collection shows border points of '{lidar}' in an annotated image of '{camera}'"
            + "".join(f"; {line}" for line in left_out[:3])
        )
    return Table(KEY, COLUMNS, tuple(labels), np.array(rows), tuple(left_out))


def _nearest(points: Array, segments: Array) -> Array:
    """The place on any of the segments (S, 2, 2) nearest to each of the points (N, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length2 = np.maximum((along * along).sum(-1), 1e-12)
    share = np.clip(((points[:, None] - start) * along).sum(-1) / length2, 0, 1)
    feet = start + share[..., None] * along  # (N, S, 2)
    away = feet - points[:, None]
    best = (away * away).sum(-1).argmin(-1)
    nearest: Array = feet[np.arange(len(points)), best]
    return nearest
