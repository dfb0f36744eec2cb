"""Pairs of views of two sensors, of the same collection or of different ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.transforms import inverse


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of views, by the indices of their collections."""

    source: IntArray
    """(P,)."""
    target: IntArray
    """(P,)."""
    T_target_source: Array
    """(P, 4, 4): between the sensors' data frames."""


def same_collection(dataset: Dataset, source: Sensor, target: Sensor, seen: Sequence[int]) -> Pairs:
    """Return the views of two sensors in each of these collections.

    Raises:
        InputError: the sensors are identical (nothing would be tested), or a transform is missing.
    """
    if source.name == target.name:
        raise InputError(
            f"'{source.name}' against itself tests nothing in one collection: use an inter-collection table"
        )
    index = np.array(seen, int)
    return Pairs(index, index, dataset.with_collections(list(seen)).transform(target.frame, source.frame))


def between_collections(
    dataset: Dataset, sensors: tuple[Sensor, Sensor], pattern: Pattern, seen: tuple[Sequence[int], Sequence[int]]
) -> Pairs:
    """Return all pairs of a view of the first sensor and a view of the second, related by the pattern's parent link.

    As in ATOM this includes pairs from one collection, except for a sensor with itself, which
    is compared once for each unordered pair of different collections.

    Raises:
        InputError: the pattern is not fixed, or a transform is missing.
    """
    require_fixed(dataset, pattern)
    a, b = (np.array(indices, int) for indices in seen)
    later = a[:, None] < b[None]
    i, j = np.nonzero(later if sensors[0].name == sensors[1].name else np.ones_like(later))
    T_parent_source, T_parent_target = (
        dataset.with_collections(list(indices)).transform(pattern.parent_link, sensor.frame)
        for sensor, indices in zip(sensors, seen, strict=True)
    )
    return Pairs(a[i], b[j], inverse(T_parent_target)[j] @ T_parent_source[i])


def require_fixed(dataset: Dataset, pattern: Pattern) -> None:
    """Raise if a pattern moves.

    Raises:
        InputError: it moves.
    """
    if not pattern.fixed:
        raise InputError(
            f"{dataset.path}: pattern '{pattern.name}' is not fixed: its collections cannot be compared with each other"
        )
