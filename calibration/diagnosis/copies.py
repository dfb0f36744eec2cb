"""Check for duplicated labels: they add no information, but double the weight and make the covariance too small."""

from collections.abc import Iterable

import numpy as np

from calibration.dataset.model import CornerLabels, Dataset, Labels, label_arrays
from calibration.errors import InputError
from calibration.geometry.transforms import distance

STILL = 1e-6
"""m, rad: transforms that differ by less are of a robot at standstill."""
STILL_PIXELS = 1.0
"""px, root mean square: corners of another camera that differ by less are of a pattern at standstill."""
NAMED = 8
"""Number of pairs that a message names."""


def check_copies(dataset: Dataset) -> None:
    """Refuse collections with labels that equal those of another one exactly.

    Single views with equal labels are refused too if the pattern has moved relative to the sensor meanwhile, by the
    transforms or by another camera. A sensor that sees a fixed pattern from a fixed pose may have equal labels
    if there is no noise: that is not a copy.

    Raises:
        InputError: names the equal ones.
    """
    prints = [{key: _print(label) for key, label in c.labels.items()} for c in dataset.collections]
    whole: dict[frozenset[tuple[tuple[str, str], int]], list[int]] = {}
    for i, views in enumerate(prints):
        if views:
            whole.setdefault(frozenset(views.items()), []).append(i)
    if pairs := _pairs(dataset, whole.values()):
        raise InputError(
            f"{dataset.path}: found collections with the same labels, to the last digit: {pairs}; expected new ones in "
            f"each: leave the copies out"
        )
    seen: dict[tuple[tuple[str, str], int], list[int]] = {}
    for i, views in enumerate(prints):
        for view in views.items():
            seen.setdefault(view, []).append(i)
    for ((pattern, sensor), _), equal in seen.items():
        copies = [equal[0], *(j for j in equal[1:] if _moved(dataset, pattern, sensor, equal[0], j))]
        if len(copies) > 1:
            raise InputError(
                f"{dataset.path}: sensor '{sensor}' has the same labels of '{pattern}', to the last digit, in "
                f"collections {_pairs(dataset, [copies])}, although something has moved between; leave the copies out, "
                f"or take the labels that belong there"
            )


def _print(label: Labels) -> int:
    """Return a hash of a label's values."""
    return hash(tuple(array.tobytes() for array in label_arrays(label)))


def _pairs(dataset: Dataset, groups: Iterable[list[int]]) -> str:
    pairs = [f"{dataset.keys[j]} = {dataset.keys[group[0]]}" for group in groups for j in group[1:]]
    return ", ".join(pairs[:NAMED]) + (f" and {len(pairs) - NAMED} more" if len(pairs) > NAMED else "")


def _moved(dataset: Dataset, pattern: str, sensor: str, i: int, j: int) -> bool:
    """Whether a pattern has moved relative to a sensor between two collections, by transforms or by another camera."""
    board = dataset.patterns[pattern]
    if board.fixed:
        T = dataset.with_collections([i, j]).transform(dataset.sensors[sensor].frame, board.parent_link)
        return any(float(d) > STILL for d in distance(T[0], T[1]))
    labels = [dataset.collections[k].labels for k in (i, j)]
    others = [key for key in labels[0] if key[0] == pattern and key[1] != sensor and key in labels[1]]
    return any(_differ(labels[0][key], labels[1][key]) for key in others)


def _differ(a: Labels, b: Labels) -> bool:
    """Whether the corners of two views differ by more than the tolerance."""
    if not (isinstance(a, CornerLabels) and isinstance(b, CornerLabels)):
        return False
    common, first, second = np.intersect1d(a.ids, b.ids, return_indices=True)
    apart = a.pixels[first] - b.pixels[second]
    return bool(len(common)) and float(np.sqrt((apart**2).sum(-1).mean())) > STILL_PIXELS
