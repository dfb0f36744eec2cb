"""Check for duplicated labels: they add no information, but double the weight and make the covariance too small."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, label_arrays
from calibration.engine.diagnosis.finding import Finding, first_names
from calibration.engine.geometry.transforms import distance

STANDSTILL_TOLERANCE = 1e-6
"""m, rad: transforms that differ by less are of a robot at standstill."""
STILL_PIXELS = 1.0
"""px, root mean square: corners of another camera that differ by less are of a pattern at standstill."""
MAX_NAMED_PAIRS = 8
"""Number of pairs that a message names."""


def check_copies(dataset: Dataset) -> None:
    """Refuse collections with labels that equal those of another one exactly.

    Single views with equal labels are refused too if the pattern has moved relative to the sensor meanwhile, by the
    transforms or by another camera. A sensor that sees a fixed pattern from a fixed pose may have equal labels
    if there is no noise: that is not a copy.

    Raises:
        InputError: names the equal ones.
    """
    if pairs := _name_pairs(dataset, _copied_collections(dataset)):
        raise InputError(
            f"{dataset.path}: found collections with the same labels, to the last digit: {pairs}; expected new ones in "
            f"each: leave the copies out (copies: leave-out)"
        )
    for (pattern, sensor), copies in _copied_views(dataset):
        raise InputError(
            f"{dataset.path}: sensor '{sensor}' has the same labels of '{pattern}', to the last digit, in "
            f"collections {_name_pairs(dataset, copies)}, although something has moved between; leave the copies out "
            f"(copies: leave-out), or take the labels that belong there"
        )


def without_copies(dataset: Dataset) -> tuple[Dataset, tuple[Finding, ...]]:
    """Return the dataset without what `check_copies` refuses, and a warning for each kind; the first of equals stay."""
    findings = []
    if copies := _copied_collections(dataset):
        copied = {j for _, j in copies}
        text = (
            f"{len(copied)} of {len(dataset.keys)} collections are copies, to the last digit, and were left out: "
            f"{_name_pairs(dataset, copies)}"
        )
        keys = tuple(dataset.keys[j] for j in sorted(copied))
        findings.append(Finding("copies", "warning", text, collections=keys, value=float(len(copied))))
        dataset = dataset.with_collections([i for i in range(len(dataset.keys)) if i not in copied])
    for (pattern, sensor), copies in _copied_views(dataset):
        keys = tuple(dataset.keys[j] for _, j in copies)
        text = (
            f"{sensor}: {len(keys)} views of '{pattern}' are copies, to the last digit, although something has moved "
            f"between, and were left out: {_name_pairs(dataset, copies)}; does its driver repeat images?"
        )
        findings.append(Finding("copies", "warning", text, (sensor,), keys, value=float(len(keys))))
        dataset = _without_views(dataset, (pattern, sensor), keys)
    return dataset, tuple(findings)


def _without_views(dataset: Dataset, view: tuple[str, str], keys: Sequence[str]) -> Dataset:
    collections = tuple(
        replace(c, labels={key: label for key, label in c.labels.items() if key != view or c.key not in keys})
        for c in dataset.collections
    )
    return replace(dataset, collections=collections)


def _copied_collections(dataset: Dataset) -> list[tuple[int, int]]:
    """Return the pairs of a collection and its copy, by index."""
    prints = _hashes_of_views(dataset)
    whole: dict[frozenset[tuple[tuple[str, str], int]], list[int]] = {}
    for i, views in enumerate(prints):
        if views:
            whole.setdefault(frozenset(views.items()), []).append(i)
    return [(first, j) for first, *others in whole.values() for j in others]


def _copied_views(dataset: Dataset) -> Iterator[tuple[tuple[str, str], list[tuple[int, int]]]]:
    """Yield the pairs of collections with a view and its copy by pattern and sensor, where something has moved."""
    seen: dict[tuple[tuple[str, str], int], list[int]] = {}
    for i, views in enumerate(_hashes_of_views(dataset)):
        for view in views.items():
            seen.setdefault(view, []).append(i)
    for ((pattern, sensor), _), (first, *others) in seen.items():
        if copies := [(first, j) for j in others if _has_moved(dataset, pattern, sensor, first, j)]:
            yield (pattern, sensor), copies


def _hashes_of_views(dataset: Dataset) -> list[dict[tuple[str, str], int]]:
    """Return the hash of each view, by collection."""
    return [{key: _hash_label(label) for key, label in c.labels.items()} for c in dataset.collections]


def _hash_label(label: Labels) -> int:
    """Return a hash of a label's values."""
    return hash(tuple(array.tobytes() for array in label_arrays(label)))


def _name_pairs(dataset: Dataset, pairs: Sequence[tuple[int, int]]) -> str:
    """Return pairs of collections as "copy = original", the first of them."""
    return first_names([f"{dataset.keys[j]} = {dataset.keys[i]}" for i, j in pairs], MAX_NAMED_PAIRS)


def _has_moved(dataset: Dataset, pattern: str, sensor: str, i: int, j: int) -> bool:
    """Whether a pattern has moved relative to a sensor between two collections, by transforms or by another camera."""
    board = dataset.patterns[pattern]
    if board.fixed:
        T = dataset.with_collections([i, j]).transform(dataset.sensors[sensor].frame, board.parent_link)
        return any(float(d) > STANDSTILL_TOLERANCE for d in distance(T[0], T[1]))
    labels = [dataset.collections[k].labels for k in (i, j)]
    others = [key for key in labels[0] if key[0] == pattern and key[1] != sensor and key in labels[1]]
    return any(_corners_differ(labels[0][key], labels[1][key]) for key in others)


def _corners_differ(a: Labels, b: Labels) -> bool:
    """Whether the corners of two views differ by more than the tolerance."""
    if not (isinstance(a, CornerLabels) and isinstance(b, CornerLabels)):
        return False
    common, first, second = np.intersect1d(a.ids, b.ids, return_indices=True)
    apart = a.pixels[first] - b.pixels[second]
    return bool(len(common)) and float(np.sqrt((apart**2).sum(-1).mean())) > STILL_PIXELS
