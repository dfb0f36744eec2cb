"""Directions turned from frame to frame, with the same rounding on every machine."""

import numpy as np

from calibration.geometry.types import Array


def turned(T_parent_child: Array, directions: Array) -> Array:
    """Directions (3, ...) of the child frame in the parent frame, coordinates on the first axis.

    Spelt out: a product of matrices rounds as the processor's library likes.
    """
    x, y, z = directions
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in T_parent_child[:3, :3]])
