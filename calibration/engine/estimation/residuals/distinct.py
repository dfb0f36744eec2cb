"""The distinct values of an array."""

import numpy as np

from calibration.base.arrays import IntArray


def distinct(values: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct values (m,), ascending, and the place of each value (n,) among them.

    As `numpy.unique`, which imports `numpy.ma`: 7 ms of each process.
    """
    order = values.argsort(kind="stable")
    ranked = values[order]
    first = np.ones(len(ranked), bool)
    first[1:] = ranked[1:] != ranked[:-1]
    places = np.empty(len(values), int)
    places[order] = np.cumsum(first) - 1
    return ranked[first], places
