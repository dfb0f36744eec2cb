"""Selection of the labels that determine the pattern's pose."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.dataset.modalities import Modality
from calibration.dataset.model import CornerLabels, Dataset, Labels, PointLabels, PoseLabels
from calibration.errors import InputError, UndeterminedError
from calibration.estimation.planar_pose import planar_poses

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
    ignored: list[str] = []
    on_lines = _on_lines(dataset)
    modalities = {name: sensor.modality for name, sensor in dataset.sensors.items()}
    kept: list[Mapping[tuple[str, str], Labels]] = []
    for i, collection in enumerate(dataset.collections):
        labels = collection.labels
        faults = {key: fault for key, label in labels.items() if (fault := _too_few(label, modalities[key[1]]))}
        if on_lines:
            faults = {key: on_lines[i, *key] for key in labels if (i, *key) in on_lines} | faults
        kept.append({key: label for key, label in labels.items() if key not in faults} if faults else labels)
        ignored += [f"collection {collection.key}, {key[1]}: {faults[key]}" for key in labels if key in faults]
    if any(modality.points for modality in modalities.values()):
        fixed = {p for labels in kept for p in _seen_by_cameras(labels) if dataset.patterns[p].fixed}
        for i, collection in enumerate(dataset.collections):
            known = fixed | _seen_by_cameras(kept[i])
            if unknown := [key for key in kept[i] if key[0] not in known]:
                kept[i] = {key: label for key, label in kept[i].items() if key not in unknown}
                ignored += [f"collection {collection.key}, {key[1]}: no camera saw '{key[0]}'" for key in unknown]
    for sensor in dataset.sensors:
        if not any(s == sensor for labels in kept for _, s in labels):
            raise InputError(f"{dataset.path}: sensor '{sensor}': no collection has enough labels of it")
    seen = {pattern for labels in kept for pattern, _ in labels}
    ignored += [
        f"pattern '{name}': no collection has enough labels of it" for name in dataset.patterns if name not in seen
    ]
    keep = [i for i, labels in enumerate(kept) if labels]
    if len(keep) < 2:
        raise UndeterminedError(
            f"{dataset.path}: {len(keep)} collection has labels; at least 2 are needed, because one view of a flat "
            f"pattern cannot be told from its mirror image"
        )
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


def _too_few(label: Labels, modality: Modality) -> str:
    """Return the reason why labels are too few for a view of a sensor; empty if they are enough."""
    if isinstance(label, CornerLabels):
        count, minimum, what = len(label.ids), MINIMUM_CORNERS, "corners"
    elif isinstance(label, PointLabels):
        count, minimum, what = len(label.points), modality.point_data.minimum, "points"
    else:
        return ""
    return f"{count} {what}, at least {minimum} are needed" if count < minimum else ""


def _on_lines(dataset: Dataset) -> dict[tuple[int, str, str], str]:
    """Return the views (collection, pattern, sensor) with an ambiguous pose: all corners but at most one on a line."""
    found: dict[tuple[int, str, str], str] = {}
    for name, pattern in dataset.patterns.items():
        K = len(pattern.corners)
        partial = {
            (i, *key): label.ids
            for i, collection in enumerate(dataset.collections)
            for key, label in collection.labels.items()
            if key[0] == name and isinstance(label, CornerLabels) and MINIMUM_CORNERS <= len(label.ids) < K
        }
        seen = np.zeros((len(partial), K), bool)
        for row, ids in zip(seen, partial.values(), strict=True):
            row[ids] = True
        straight_ahead = np.broadcast_to(pattern.corners[:, :2].T, (len(partial), 2, K))
        poses = planar_poses(straight_ahead, pattern.corners, seen)
        found |= {
            view: "its corners lie on a line" for view, T in zip(partial, poses, strict=True) if np.isnan(T[0, 0])
        }
    return found
