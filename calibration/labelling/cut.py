"""Where the plane of a 2D LiDAR's scan cuts a pattern."""

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array


def cut_ends(pattern: Pattern, T_sensor_pattern: Array) -> Array:
    """The two places (..., 2, 2) in the plane z = 0 of the sensor between which it cuts a pattern, x and y.

    Args:
        pattern: its outline is what is cut.
        T_sensor_pattern: (..., 4, 4).

    Returns:
        NaN where it does not cut it.
    """
    corners = apply(T_sensor_pattern, np.append(pattern.outline, np.zeros((4, 1)), -1))  # (..., 4, 3)
    following = np.roll(corners, -1, axis=-2)
    z0, z1 = corners[..., 2], following[..., 2]
    crosses = (z0 < 0) != (z1 < 0)  # of a convex outline, no side or two
    with np.errstate(divide="ignore", invalid="ignore"):
        places = corners + (z0 / (z0 - z1))[..., None] * (following - corners)
    order = np.argsort(~crosses, axis=-1, kind="stable")[..., :2]
    ends = np.take_along_axis(places[..., :2], order[..., None], axis=-2)
    cut: Array = np.where(crosses.any(-1)[..., None, None], ends, np.nan)
    return cut
