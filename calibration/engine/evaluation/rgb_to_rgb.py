"""Agreement of two cameras: corners of one, transferred to the image of the other.

ATOM's evaluations ``rgb_to_rgb`` and ``inter_collection_rgb_to_rgb``. The source camera's own view
gives the pose of the pattern; the rays of its labels meet the pattern's plane; these points are
moved to the target camera by the calibrated transforms, and their pixels compared with the target's
labels of the same ids (in ATOM: the labels mapped by the homography that the plane induces).
Two more columns compare the pattern poses estimated by each camera alone, including the noise of both. Their
distance is measured at the pattern's first corner, the origin of ATOM's PnP: the distance of two poses that are
turned against each other depends on the point.
"""

from dataclasses import replace

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.evaluation.views import CornerViews, between_collections, camera_of, corner_views, pattern_of
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
    values = [_error_columns(views[0][pairs[0, r]], views[1][pairs[1, r]], T_target_source[r], camera) for r in chunks]
    return Table(
        COLLECTION_HEADER, RGB_TO_RGB_COLUMNS, tuple(labels[r] for r in rows), np.concatenate(values), tuple(left_out)
    )


def _error_columns(source: CornerViews, target: CornerViews, T_target_source: Array, camera: Camera) -> Array:
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
