"""Scans of 2D LiDARs: ROS LaserScan messages, with their ranges inside the dataset's JSON."""

import math

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node

MAX_RAYS = 1 << 20
"""Limit of the number of rays of a scan."""
_MAX_SCAN_ANGLE = 2 * math.pi * 1.02
"""Limit of a scan's angle: the last rays of a rotating LiDAR may overlap the first."""


def read_scan(message: Node) -> Array:
    """Convert a LaserScan to points (N, 3) in the sensor's frame (m), one for each ray, all with z = 0.

    The ray k points along ``angle_min + k * angle_increment``, from x to y. NaN for a ray without a return: a range
    that is not finite, not above 0, or outside of ``range_min`` to ``range_max`` where the message has them.

    Raises:
        InputError: something in the message is missing or wrong.
    """
    ranges = _read_ranges(message["ranges"])
    start, step = message["angle_min"].within(-10, 10), message["angle_increment"].within(-1, 1)
    if step == 0:
        raise message["angle_increment"].unexpected("the angle between two rays, rad")
    if abs(step) * (len(ranges) - 1) > _MAX_SCAN_ANGLE:
        raise message["angle_increment"].fault(
            f"{len(ranges)} rays of {step:g} rad make more than one revolution; are the angles in degrees?"
        )
    least, most = _read_range_limit(message, "range_min", 0.0), _read_range_limit(message, "range_max", math.inf)
    with np.errstate(invalid="ignore"):
        returned = np.isfinite(ranges) & (ranges > 0) & (ranges >= least) & (ranges <= most)
    r, angle = np.where(returned, ranges, np.nan), start + step * np.arange(len(ranges))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.where(returned, 0.0, np.nan)], -1)


def _read_ranges(node: Node) -> Array:
    """Return the ranges (N,), NaN for null."""
    values = node.sequence()
    if len(values) > MAX_RAYS:
        raise node.fault(f"found {len(values)} ranges, expected {MAX_RAYS} at most")
    try:
        if set(map(type, values)) <= {float, int, type(None)}:
            return np.array([math.nan if value is None else float(value) for value in values])
    except OverflowError:  # an integer beyond the range of floats
        pass
    wrong = next(element for element in node.elements() if not _is_range(element.value))
    raise wrong.unexpected("a range in m, or NaN, Infinity or null where nothing came back")


def _is_range(value: object) -> bool:
    return value is None or type(value) is float or (type(value) is int and abs(value) < 10**300)


def _read_range_limit(message: Node, key: str, otherwise: float) -> float:
    """Return a limit of the ranges; some drivers set the upper one to infinity."""
    node = message.get(key)
    return otherwise if node is None or node.value == math.inf else node.number()
