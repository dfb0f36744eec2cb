"""Datasets with one convention changed."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, PoseLabels

LabelChange = Callable[[str, str, Labels], Labels]
"""From a pattern, a sensor, and what it saw to what it should have seen."""


def with_labels(dataset: Dataset, change: LabelChange) -> Dataset:
    """Return the dataset with all labels changed."""
    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={key: change(*key, label) for key, label in c.labels.items()})
            for c in dataset.collections
        ),
    )


def with_mirrored(dataset: Dataset, sensor: str) -> Dataset:
    """Return the dataset with a camera's images mirrored left to right, or a sensor's points in y.

    Any reflection corrects mirrored data: it differs from the right one by a rotation, which a calibration finds.
    """
    camera = dataset.sensors[sensor].camera

    def reflected(_: str, name: str, label: Labels) -> Labels:
        if name != sensor or isinstance(label, PoseLabels):
            return label
        if isinstance(label, PointLabels):
            return replace(label, points=label.points * (1, -1, 1))
        width = camera.width if camera else 0
        return CornerLabels(label.ids, np.stack([width - 1 - label.pixels[:, 0], label.pixels[:, 1]], -1))

    return with_labels(dataset, reflected)


def with_mirrored_numbering(dataset: Dataset, sensor: str, pattern: str, across: bool) -> Dataset:
    """Return the dataset with a sensor's corners of a board numbered from the other end of each row, or column."""
    board = dataset.patterns[pattern]
    columns = board.columns
    row, column = np.divmod(np.arange(len(board.corners)), columns)
    rows = len(board.corners) // columns
    ids = (rows - 1 - row) * columns + column if across else row * columns + columns - 1 - column

    def numbered(name: str, seeing: str, label: Labels) -> Labels:
        if (name, seeing) != (pattern, sensor) or not isinstance(label, CornerLabels):
            return label
        order = np.argsort(ids[label.ids])
        return CornerLabels(ids[label.ids][order], label.pixels[order])

    return with_labels(dataset, numbered)


def with_exchanged_labels(dataset: Dataset, a: str, b: str, keys: Collection[str] | None = None) -> Dataset:
    """Return the dataset with the labels of two sensors exchanged, in all collections or in some."""
    names = {a: b, b: a}
    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={(p, names.get(s, s)): label for (p, s), label in c.labels.items()})
            if keys is None or c.key in keys
            else c
            for c in dataset.collections
        ),
    )


def with_exchanged_cameras(dataset: Dataset, a: str, b: str) -> Dataset:
    """Return the dataset with the intrinsics of two cameras exchanged."""
    one, other = dataset.sensors[a].camera, dataset.sensors[b].camera
    return dataset.with_cameras({a: other, b: one}) if one and other else dataset


def with_later_labels(dataset: Dataset, by: int, sensors: Collection[str]) -> Dataset:
    """Return the dataset with some sensors' labels of the collection that is ``by`` later, without those at the end."""
    N = len(dataset.collections)
    keep = range(max(0, -by), min(N, N - by))
    kept = dataset.with_collections(keep)
    collections = tuple(
        replace(
            dataset.collections[i],
            labels={
                key: label
                for at, own in ((i + by, True), (i, False))
                for key, label in dataset.collections[at].labels.items()
                if (key[1] in sensors) == own
            },
        )
        for i in keep
    )
    return replace(kept, collections=collections)


def with_scaled_patterns(dataset: Dataset, by: float) -> Dataset:
    """Return the dataset with patterns, and their measured positions, of another size."""
    patterns = {n: replace(p, corners=p.corners * by, outline=p.outline * by) for n, p in dataset.patterns.items()}

    def scaled(_: str, __: str, label: Labels) -> Labels:
        return PoseLabels(scaled_translations(label.T, by)) if isinstance(label, PoseLabels) else label

    return replace(with_labels(dataset, scaled), patterns=patterns)


def scaled_translations(T: Array, by: float) -> Array:
    """Return transforms (..., 4, 4) with other units of length."""
    out = np.array(T, float)
    out[..., :3, 3] *= by
    return out


def with_measured(dataset: Dataset, sensor: str, pattern: str, poses: Mapping[int, Array]) -> Dataset:
    """Return the dataset with other measured poses (4, 4), by collection."""
    key = (pattern, sensor)
    collections = tuple(
        replace(c, labels={**c.labels, key: PoseLabels(poses[i])}) if i in poses else c
        for i, c in enumerate(dataset.collections)
    )
    return replace(dataset, collections=collections)


def with_later_motion(dataset: Dataset, edge: Edge, by: int) -> Dataset:
    """Return the dataset with one transform of the collection that is ``by`` later, without those at the end."""
    N = len(dataset.collections)
    keep = range(max(0, -by), min(N, N - by))
    moved = np.roll(dataset.transforms[edge], -by, axis=0)
    return dataset.with_transforms({edge: moved}).with_collections(keep)


def with_joint_positions(dataset: Dataset, name: str, positions: Array) -> Dataset:
    """Return the dataset with other positions (N,) of a joint with calibrated parameters."""
    joint = replace(dataset.joints[name], positions=positions)
    changed = replace(dataset, joints={**dataset.joints, name: joint})
    return changed.with_transforms({joint.edge: joint.transform})
