"""Agreement of two sensors: what one saw of a pattern, carried to the other by the calibrated transforms.

Two cameras: ATOM's evaluations ``rgb_to_rgb`` and ``inter_collection_rgb_to_rgb``. The source camera's own view
gives the pose of the pattern; the rays of its labels meet the pattern's plane; these points are
moved to the target camera by the calibrated transforms, and their pixels compared with the target's
labels of the same ids (in ATOM: the labels mapped by the homography that the plane induces).
Two more columns compare the pattern poses estimated by each camera alone, including the noise of both. Their
distance is measured at the pattern's first corner, the origin of ATOM's PnP: the distance of two poses that are
turned against each other depends on the point.

A LiDAR or a depth camera, and a camera: ATOM's ``lidar_to_rgb`` and ``depth_to_rgb``. The limit points are projected
into the image, and each is compared with the nearest point on the lines of the border's annotation (in ATOM with the
nearest of its points); also between collections. The annotation is drawn by hand in ATOM. It can also be computed: from
the true poses if they are known, or from the detected corners, which give the pose of the whole pattern.

Two LiDARs or depth cameras: each point of the one against the nearest point of the other.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.document import Node, read_json
from calibration.engine.dataset.model import Dataset, PointLabels, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.evaluation.table import COLLECTION_HEADER, COLLECTION_PAIR, Table
from calibration.engine.evaluation.truth import Truth
from calibration.engine.evaluation.views import (
    CornerViews,
    between_collections,
    camera_of,
    corner_views,
    depth_of,
    lidar3d_of,
    lidar_of,
    pattern_of,
    point_views,
    same_collection,
)
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse, translation

RGB_TO_RGB_COLUMNS = ("RMS (pix)", "X err (pix)", "Y err (pix)", "Trans (mm)", "Rot (deg)")
_PAIRS_PER_CHUNK = 1024  # chunk size (pairs), to bound the memory


def rgb_to_rgb(dataset: Dataset, source: str, target: str, pattern: str | None = None) -> Table:
    """Return the errors between two cameras in each collection that both saw.

    Columns, over the corners seen by both: the root of the mean squared distance, the mean absolute
    error along x and y (px); the distance (mm) of the pattern's first corner and the angle (deg) between the
    pattern poses estimated by each camera alone.

    Args:
        dataset: the transforms to evaluate.
        source: the camera whose labels are transferred.
        target: the camera whose labels they are compared with.
        pattern: its name; None if there is only one.

    Raises:
        InputError: no such camera or pattern, a transform is missing, no collection seen by both, or
            source and target are the same (nothing would be tested).
    """
    if source == target:
        raise InputError(f"'{source}' against itself tests nothing in one collection: use inter-collection-rgb-to-rgb")
    seen_pattern = pattern_of(dataset, pattern)
    a, b = (_corner_views_from_first(dataset, name, seen_pattern) for name in (source, target))
    common, in_a, in_b = np.intersect1d(a.collections, b.collections, assume_unique=True, return_indices=True)
    frames = camera_of(dataset, target)[0].frame, camera_of(dataset, source)[0].frame
    T_target_source = dataset.with_collections(common.tolist()).transform(*frames)
    labels = [dataset.keys[i] for i in common]
    return _rgb_to_rgb_table(dataset, (source, target), (a, b), np.stack([in_a, in_b]), T_target_source, labels)


def inter_collection_rgb_to_rgb(dataset: Dataset, source: str, target: str, pattern: str | None = None) -> Table:
    """Return the errors between a view of one camera in one collection and a view of the other in another.

    The pattern is fixed to its parent link, through which the two views are related. There is a row
    for every pair of `between_collections`, labelled ``000-001``. Columns, arguments and errors as `rgb_to_rgb`.

    Raises:
        InputError: also when the pattern is not fixed.
    """
    seen_pattern = pattern_of(dataset, pattern)
    a, b = (_corner_views_from_first(dataset, name, seen_pattern) for name in (source, target))
    sensors = camera_of(dataset, source)[0], camera_of(dataset, target)[0]
    seen = a.collections.tolist(), b.collections.tolist()
    found = between_collections(dataset, sensors, seen_pattern, seen)
    pairs = np.stack([np.searchsorted(a.collections, found.source), np.searchsorted(b.collections, found.target)])
    return _rgb_to_rgb_table(dataset, (source, target), (a, b), pairs, found.T_target_source, found.names)


def _corner_views_from_first(dataset: Dataset, sensor: str, pattern: Pattern) -> CornerViews:
    """Return `corner_views` with poses whose origin is the pattern's first corner."""
    views = corner_views(dataset, sensor, pattern)
    return replace(views, T_camera_pattern=views.T_camera_pattern @ translation(pattern.corners[0]))


def _rgb_to_rgb_table(
    dataset: Dataset,
    names: tuple[str, str],
    views: tuple[CornerViews, CornerViews],
    pairs: IntArray,
    T_target_source: Array,
    labels: list[str],
) -> Table:
    """Return the table of pairs (2, P): views of the source, views of the target."""
    left_out = list(dict.fromkeys((*views[0].left_out, *views[1].left_out)))
    if not labels:
        counts = ", ".join(f"'{n}' has {len(v.collections)} views" for n, v in zip(names, views, strict=True))
        raise InputError(f"{dataset.path}: nothing seen by both: {counts}" + "".join(f"; {s}" for s in left_out[:3]))
    common = views[0].seen.astype(float) @ views[1].seen.T  # number of common corners, for any two views
    shared = common[pairs[0], pairs[1]] > 0
    left_out += [f"{label}: no corner seen by both" for label, both in zip(labels, shared, strict=True) if not both]
    if not shared.any():
        raise InputError(f"{dataset.path}: '{names[0]}' and '{names[1]}' see no corner in common")
    camera = camera_of(dataset, names[1])[1]
    rows = np.flatnonzero(shared)
    chunks = (rows[start : start + _PAIRS_PER_CHUNK] for start in range(0, len(rows), _PAIRS_PER_CHUNK))
    values = [
        _rgb_error_columns(views[0][pairs[0, r]], views[1][pairs[1, r]], T_target_source[r], camera) for r in chunks
    ]
    return Table(
        COLLECTION_HEADER, RGB_TO_RGB_COLUMNS, tuple(labels[r] for r in rows), np.concatenate(values), tuple(left_out)
    )


def _rgb_error_columns(source: CornerViews, target: CornerViews, T_target_source: Array, camera: Camera) -> Array:
    """Return the columns (P, 5) of pairs of views."""
    T_sp, T_tp = source.T_camera_pattern, target.T_camera_pattern
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # NaN: rays that do not intersect the plane
        rays = source.rays.swapaxes(1, 2)
        normal = T_sp[:, :3, 2]
        depth = (normal * T_sp[:, :3, 3]).sum(-1)[:, None] / np.einsum("pki,pi->pk", rays, normal)
        projected = camera.project(apply(T_target_source, rays * depth[..., None]))
    both = source.seen & target.seen
    error = np.where(both[..., None], projected - target.pixels.swapaxes(1, 2), 0.0)
    count = both.sum(-1)
    rms = np.sqrt((error * error).sum((1, 2)) / count)
    absolute = np.abs(error).sum(1) / count[:, None]
    apart = inverse(T_target_source @ T_sp) @ T_tp
    distance = 1000 * np.linalg.norm(apart[:, :3, 3], axis=-1)
    turn = np.degrees(rotations.angle(apart[:, :3, :3]))
    return np.column_stack([rms, absolute, distance, turn])


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
    for i, j, T, name in pairs:
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
    for i, j, T, name in pairs:
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
