"""Selection of the labels that determine the pattern's pose."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels, PoseLabels
from calibration.engine.estimation.residuals.planar_pose import determines_pose

MINIMUM_CORNERS = 4
"""Minimum of corners: fewer do not determine a pattern's pose, and would add flipped ones."""


def usable_labels(dataset: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Remove labels that determine nothing, and collections and patterns that have none left.

    Views of a LiDAR or a depth camera need a camera that saw the pattern: at the same moment, or ever when it is fixed.

    Returns:
        The dataset, and descriptions of the removed labels with the reasons.

    Raises:
        InputError: a sensor has no labels left.
        UndeterminedError: fewer than two collections are left.
    """
    faults = _faulty_labels(dataset)
    kept: list[Mapping[tuple[str, str], Labels]] = [collection.labels for collection in dataset.collections]
    ignored = []
    for i in sorted({i for i, _ in faults}):
        labels = kept[i]
        ignored += [f"collection {dataset.keys[i]}, {k[1]}: {faults[i, k]}" for k in labels if (i, k) in faults]
        kept[i] = {key: label for key, label in labels.items() if (i, key) not in faults}
    modalities = [sensor.modality for sensor in dataset.sensors.values()]
    if any(modality.points for modality in modalities):
        fixed = {p for labels in kept for p in _seen_by_cameras(labels) if dataset.patterns[p].fixed}
        for i, collection in enumerate(dataset.collections):
            known = fixed | _seen_by_cameras(kept[i])
            if unknown := [key for key in kept[i] if key[0] not in known]:
                kept[i] = {key: label for key, label in kept[i].items() if key not in unknown}
                ignored += [f"collection {collection.key}, {key[1]}: no camera saw '{key[0]}'" for key in unknown]
    views = set().union(*kept)
    for sensor in dataset.sensors:
        if not any(s == sensor for _, s in views):
            raise InputError(f"{dataset.path}: sensor '{sensor}': no collection has enough labels of it")
    seen = {pattern for pattern, _ in views}
    ignored += [
        f"pattern '{name}': no collection has enough labels of it" for name in dataset.patterns if name not in seen
    ]
    keep = [i for i, labels in enumerate(kept) if labels]
    if len(keep) < 2:
        raise UndeterminedError(
            f"{dataset.path}: {len(keep)} collection has labels; at least 2 are needed, because one view of a flat "
            f"pattern cannot be told from its mirror image"
        )
    if not ignored and len(keep) == len(kept):
        return dataset, ()
    usable = replace(
        dataset,
        patterns={name: pattern for name, pattern in dataset.patterns.items() if name in seen},
        collections=tuple(
            c if labels is c.labels else replace(c, labels=labels)
            for c, labels in zip(dataset.collections, kept, strict=True)
        ),
    )
    return usable if len(keep) == len(kept) else usable.with_collections(keep), tuple(ignored)


def _seen_by_cameras(labels: Mapping[tuple[str, str], Labels]) -> set[str]:
    """Return the patterns with corners or measured poses."""
    return {pattern for (pattern, _), label in labels.items() if isinstance(label, CornerLabels | PoseLabels)}


def _faulty_labels(dataset: Dataset) -> dict[tuple[int, tuple[str, str]], str]:
    """Return the labels that determine too little, by collection and by (pattern, sensor), with the reasons."""
    K = {name: len(pattern.corners) for name, pattern in dataset.patterns.items()}
    faults = {}
    partial: dict[str, dict[tuple[int, tuple[str, str]], IntArray]] = {}
    for i, collection in enumerate(dataset.collections):
        for key, label in collection.labels.items():
            if isinstance(label, CornerLabels):
                count = len(label.ids)
                if count < MINIMUM_CORNERS:
                    faults[i, key] = f"{count} corners, at least {MINIMUM_CORNERS} are needed"
                elif count < K[key[0]]:
                    partial.setdefault(key[0], {})[i, key] = label.ids
            elif isinstance(label, PointLabels):
                count, minimum = len(label.points), dataset.sensors[key[1]].modality.point_data.minimum
                if count < minimum:
                    faults[i, key] = f"{count} points, at least {minimum} are needed"
    for pattern, views in partial.items():
        seen = np.zeros((len(views), K[pattern]), bool)
        for row, ids in zip(seen, views.values(), strict=True):
            row[ids] = True
        usable = determines_pose(dataset.patterns[pattern].corners, seen)
        faults |= {view: "its corners lie on a line" for view, ok in zip(views, usable, strict=True) if not ok}
    return faults
