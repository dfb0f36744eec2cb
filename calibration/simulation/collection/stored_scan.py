"""The scan of a 2D LiDAR as a dataset keeps it: a ROS LaserScan, whole."""

from typing import Any

import numpy as np

from calibration.geometry.types import Array
from calibration.simulation.rendering.lidar import Scan
from calibration.simulation.sensors import SimulatedLidar2d

_DECIMALS = 6
"""A micrometre: the last bits of a machine's arithmetic do not show."""
_ANGLE_DECIMALS = 12


def stored_ranges(lidar: SimulatedLidar2d, scan: Scan) -> Array:
    """(rays,): m; 0 where nothing came back, or noise put it out of the sensor's range: JSON has no NaN."""
    ranges = np.round(scan.ranges[0], _DECIMALS)
    with np.errstate(invalid="ignore"):
        returned = (ranges >= lidar.least_range) & (ranges <= lidar.most_range)
    return np.where(returned, ranges, 0.0)


def scan_points(lidar: SimulatedLidar2d, ranges: Array) -> Array:
    """(rays, 3) in the sensor's frame, m; NaN where nothing came back."""
    points: Array = np.where(ranges > 0, ranges, np.nan)[:, None] * lidar.directions()[0]
    return points


def scan_message(lidar: SimulatedLidar2d, ranges: Array, header: dict[str, Any]) -> dict[str, Any]:
    """The LaserScan."""
    return {
        "header": header,
        "angle_min": round(lidar.angle_min, _ANGLE_DECIMALS),
        "angle_max": round(lidar.angle_max, _ANGLE_DECIMALS),
        "angle_increment": round(lidar.step, _ANGLE_DECIMALS),
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": lidar.least_range,
        "range_max": lidar.most_range,
        "ranges": ranges.tolist(),
        "intensities": [],
    }
