"""Annotation of a pattern's border in a camera's images, the reference for border points of range sensors.

In ATOM it is drawn by hand. It can also be computed: from the true poses if they are known, or from
the detected corners, which give the pose of the whole pattern.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, NotNumbersError, finite, read_json
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.truth import Truth
from calibration.engine.evaluation.selection import camera_of
from calibration.engine.evaluation.views import corner_views
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
    edge = (pattern.parent_link, pattern.link)
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
