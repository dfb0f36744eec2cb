"""Agreement of a LiDAR or a depth camera with a camera: points on the pattern's border, projected into the image.

ATOM's evaluations ``lidar_to_rgb`` and ``depth_to_rgb``: the limit points are projected into the image, and
each is compared with the nearest point on the lines of the border's annotation (in ATOM with the nearest
of its points); also between collections.

The annotation is drawn by hand in ATOM. It can also be computed: from the true poses if they are known, or from
the detected corners, which give the pose of the whole pattern.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, NotNumbersError, finite, read_json
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.truth import Truth
from calibration.engine.evaluation.table import COLLECTION_HEADER, COLLECTION_PAIR, Table
from calibration.engine.evaluation.views import (
    between_collections,
    camera_of,
    corner_views,
    depth_of,
    lidar_of,
    pattern_of,
    point_views,
    same_collection,
)
from calibration.engine.geometry.transforms import apply

Annotation = Mapping[str, Array]
"""Line segments (S, 2, 2) by the key of a collection, each from pixel (x, y) to pixel (x, y)."""

_SIDE_NAMES = ("top", "right", "bottom", "left")
_SEGMENTS_PER_PIECE = 32  # per side, because distortion bends it


def read_annotation(path: Path | str) -> Annotation:
    """Read ATOM's annotation: ``{collection: {side: {"ixs": [...], "iys": [...]}}}``, a polyline for each side.

    ``ixs, iys`` are the interpolated points; without them the drawn points ``xs, ys`` are used.

    Raises:
        InputError: the file cannot be read or does not have this form.
    """
    root = read_json(Path(path))
    return {key: np.concatenate([_segments_of_side(node[side]) for side in _SIDE_NAMES]) for key, node in root.items()}


def _segments_of_side(side: Node) -> Array:
    """Return the segments of a polyline; none for fewer than two points."""
    xs, ys = ("ixs", "iys") if side.get("ixs") is not None else ("xs", "ys")
    count = len(side[xs].sequence())
    try:
        points = np.stack([finite(side[axis].sequence()) for axis in (xs, ys)], 1)
    except (NotNumbersError, ValueError):  # one by one, so that the error names the wrong one
        points = np.array([side[axis].numbers(count) for axis in (xs, ys)], float).T
    return np.stack([points[:-1], points[1:]], 1)


def annotate(dataset: Dataset, camera: str, pattern: Pattern, T_camera_pattern: Mapping[int, Array]) -> Annotation:
    """Project the border of a pattern from known poses.

    Args:
        dataset: the dataset to annotate.
        camera: the camera.
        pattern: the pattern.
        T_camera_pattern: (4, 4) by the index of the collection.
    """
    _, intrinsics = camera_of(dataset, camera)
    corners = np.column_stack([pattern.outline, np.zeros(4)])
    share = np.linspace(0, 1, _SEGMENTS_PER_PIECE + 1)[:, None]
    sides = [(1 - share) * a + share * b for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    starts, ends = (np.concatenate([side[part] for side in sides]) for part in (slice(None, -1), slice(1, None)))
    annotation = {}
    for i, T in T_camera_pattern.items():
        (a, a_seen), (b, b_seen) = (intrinsics.project_visible(apply(T, points)) for points in (starts, ends))
        annotation[dataset.keys[i]] = np.stack([a, b], 1)[a_seen & b_seen]
    return annotation


def annotate_detections(dataset: Dataset, camera: str, pattern: Pattern) -> Annotation:
    """Return the border of a pattern from the camera's own corners, where it detected them."""
    views = corner_views(dataset, camera, pattern)
    poses = zip(views.collections.tolist(), views.T_camera_pattern, strict=True)
    return annotate(dataset, camera, pattern, dict(poses))


def annotate_truth(dataset: Dataset, camera: str, pattern: Pattern, truth: Truth) -> Annotation:
    """Return the border of a pattern from the true poses of camera and pattern, if the true pattern pose is known.

    Raises:
        InputError: a transform between camera and pattern is missing.
    """
    sensor, _ = camera_of(dataset, camera)
    edge = pattern.edge
    known = {i: truth.patterns.get(key, {}).get(edge, truth.transforms.get(edge)) for i, key in enumerate(dataset.keys)}
    poses = {i: T for i, T in known.items() if T is not None}
    true = dataset.with_transforms({e: T for e, T in truth.transforms.items() if e in dataset.transforms})
    T_camera_parent = true.with_collections(list(poses)).transform(sensor.frame, pattern.parent_link)
    chained = {i: T_camera_parent[n] @ T for n, (i, T) in enumerate(poses.items())}
    return annotate(dataset, camera, pattern, chained)


def annotation_for(dataset: Dataset, camera: str, pattern: Pattern, truth: Truth | None) -> Annotation:
    """Return the first available annotation of a camera's images.

    In order: ATOM's file ``annotation_<camera>.json`` beside the dataset; the border from the true poses; the border
    from the camera's own corners.

    Raises:
        InputError: the file has another form, or a transform is missing.
    """
    path = dataset.path.parent / f"annotation_{camera}.json"
    if path.is_file():
        return read_annotation(path)
    made = annotate_truth(dataset, camera, pattern, truth) if truth is not None else {}
    return made or annotate_detections(dataset, camera, pattern)


RANGE_TO_RGB_COLUMNS = ("RMS (pix)", "X err (pix)", "Y err (pix)")


def lidar_to_rgb(
    dataset: Dataset,
    lidar: str,
    camera: str,
    annotation: Annotation,
    pattern: str | None = None,
    *,
    between: bool = False,
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
        between: compare the points of every collection with the image of every other one, for a fixed pattern; a row
            is labelled with the camera's collection first, as in ATOM.

    Raises:
        InputError: no such sensor or pattern, a transform is missing, no collection has both border points on the
            image and an annotation, or the pattern moves between the compared collections.
    """
    key = COLLECTION_PAIR if between else None
    return _range_to_rgb_table(dataset, lidar_of(dataset, lidar), camera, annotation, pattern, key)


def depth_to_rgb(
    dataset: Dataset,
    depth: str,
    camera: str,
    annotation: Annotation,
    pattern: str | None = None,
    *,
    between: bool = False,
) -> Table:
    """Return `lidar_to_rgb` for the border points of a depth camera, whose collection is first in the labels."""
    key = COLLECTION_HEADER if between else None
    return _range_to_rgb_table(dataset, depth_of(dataset, depth)[0], camera, annotation, pattern, key)


def _range_to_rgb_table(
    dataset: Dataset,
    sensor: Sensor,
    camera_name: str,
    annotation: Annotation,
    pattern: str | None,
    between: str | None,
) -> Table:
    """Return the table of each collection, or of all pairs of collections with `between` as the labels' header."""
    camera, intrinsics = camera_of(dataset, camera_name)
    views = point_views(dataset, sensor, pattern_of(dataset, pattern))
    segments = [annotation.get(key, np.empty((0, 2, 2))) for key in dataset.keys]
    if between:
        annotated = [i for i, each in enumerate(segments) if len(each)]
        seen, target_first = (list(views), annotated), between == COLLECTION_PAIR
        pairs = between_collections(dataset, (sensor, camera), pattern_of(dataset, pattern), seen, target_first)
    else:
        pairs = same_collection(dataset, sensor, camera, list(views))
    labels, rows, left_out = [], [], []
    for i, j, T, name in zip(
        pairs.source.tolist(), pairs.target.tolist(), pairs.T_target_source, pairs.names, strict=True
    ):
        pixels, visible = intrinsics.project_visible(apply(T, views[i].points[views[i].limits]))
        with np.errstate(invalid="ignore"):
            pixels = pixels[visible & intrinsics.contains(pixels)]
        if not len(segments[j]):
            left_out.append(f"{name}: the pattern's border is not annotated")
        elif not len(pixels):
            left_out.append(
                f"{name}: none of the {len(views[i].limits)} border points of {sensor.name} is on the image"
            )
        else:
            error = _nearest_on_segments(pixels, segments[j]) - pixels
            labels.append(name)
            rows.append([np.sqrt((error * error).sum(-1).mean()), *np.abs(error).mean(0)])
    if not rows:
        raise InputError(
            f"{dataset.path}: no collection shows border points of '{sensor.name}' in an annotated image of "
            f"'{camera.name}'" + "".join(f"; {line}" for line in left_out[:3])
        )
    return Table(between or COLLECTION_HEADER, RANGE_TO_RGB_COLUMNS, tuple(labels), np.array(rows), tuple(left_out))


def _nearest_on_segments(points: Array, segments: Array) -> Array:
    """Return the point on any of the segments (S, 2, 2) nearest to each of the points (N, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length2 = np.maximum((along * along).sum(-1), 1e-12)
    share = np.clip(((points[:, None] - start) * along).sum(-1) / length2, 0, 1)
    feet = start + share[..., None] * along  # (N, S, 2)
    away = feet - points[:, None]
    best = (away * away).sum(-1).argmin(-1)
    return np.asarray(feet[np.arange(len(points)), best])
