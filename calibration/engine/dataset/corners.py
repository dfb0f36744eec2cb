"""Parse lists of numbered points ``{id, x, y}``, as in labels and patterns."""

from collections.abc import Iterable
from itertools import chain
from operator import itemgetter

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, NotNumbersError, finite

CORNER_KEYS = ("id", "x", "y")


def read_corners(lists: Iterable[Node]) -> tuple[Array, Array]:
    """Return the ids (K,), not yet checked to be integers, and coordinates (K, 2) of all lists, concatenated.

    Raises:
        InputError: a key is missing, or a value is not a finite number.
    """
    nodes = list(lists)
    corners = list(chain.from_iterable(node.sequence() for node in nodes))
    try:
        columns = finite(list(chain.from_iterable(map(itemgetter(key), corners) for key in CORNER_KEYS))).reshape(3, -1)
    except (NotNumbersError, KeyError, TypeError):  # check one by one, to report the first invalid one
        elements = chain.from_iterable(node.elements() for node in nodes)
        columns = np.array([[element[key].number() for key in CORNER_KEYS] for element in elements]).T
    return columns[0], np.ascontiguousarray(columns[1:].T)
