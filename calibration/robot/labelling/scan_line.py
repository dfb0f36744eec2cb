"""Detection of a pattern in a 2D LiDAR's scan: the rays on the pattern, and the ends of its scan line."""

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.transforms import apply
from calibration.engine.statistics import median
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import (
    DEFAULT_TOLERANCE_M,
    LEAST_SIGMA,
    MAX_INLIER_SIGMAS,
    MIN_OTHER_OBJECT_M,
    SEE_THROUGH,
    PatternPoints,
    agreed_fit,
)


def scan_line_ends(pattern: Pattern, T_sensor_pattern: Array) -> Array:
    """Return the ends (..., 2, 2), x and y, of a pattern's scan line: its intersection with the sensor's plane z = 0.

    Args:
        pattern: its outline is intersected.
        T_sensor_pattern: (..., 4, 4).

    Returns:
        NaN if they do not intersect.
    """
    corners = apply(T_sensor_pattern, np.append(pattern.outline, np.zeros((4, 1)), -1))  # (..., 4, 3)
    following = np.roll(corners, -1, axis=-2)
    z0, z1 = corners[..., 2], following[..., 2]
    crosses = (z0 < 0) != (z1 < 0)  # a convex outline is crossed at no side or at two
    with np.errstate(divide="ignore", invalid="ignore"):
        places = corners + (z0 / (z0 - z1))[..., None] * (following - corners)
    order = np.argsort(~crosses, axis=-1, kind="stable")[..., :2]
    ends = np.take_along_axis(places[..., :2], order[..., None], axis=-2)
    return np.where(crosses.any(-1)[..., None, None], ends, np.nan)


LEAST_POINTS = 5
"""Minimum of points on a pattern."""
LEAST_LENGTH = 0.1
"""m: minimum length of a scan line: a shorter one may not exist at the pattern's true pose."""
MAX_MISSING_RAYS = 3
"""The points on a pattern are one run of rays with fewer missing ones in a row than this."""


def label_scan_line(
    points: Array, pattern: Pattern, T_sensor_pattern: Array, tolerance: float = DEFAULT_TOLERANCE_M
) -> PatternPoints | NotDetected:
    """Find the rays of a scan on a pattern, by a search for its line.

    The first and the last of them are the ends of the scan line, unless the scan ends there, a nearer object occludes
    what is beyond, or the line continues.

    Args:
        points: (N, 3) in the sensor's frame, m, in the order of the rays; NaN without a return.
        pattern: its geometry.
        T_sensor_pattern: (4, 4), expected pose of the pattern.
        tolerance: limit of the distance of any point of the pattern from its expected position, m.
    """
    ends = scan_line_ends(pattern, T_sensor_pattern)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if not length > LEAST_LENGTH:
        return NotDetected("the scan does not cross the pattern at its expected pose")
    along = (ends[1] - ends[0]) / length
    away = np.array([-along[1], along[0]])
    away *= -1.0 if away @ ends[0] < 0 else 1.0
    place, height = (points[:, :2] - ends.mean(0)) @ along, (points[:, :2] - ends.mean(0)) @ away
    with np.errstate(invalid="ignore"):
        near = (np.abs(place) < length / 2 + tolerance) & (np.abs(height) < tolerance)
    if near.sum() < LEAST_POINTS:
        return NotDetected(f"{near.sum()} points where the pattern is expected, at least {LEAST_POINTS} are needed")
    offset, slope, sigma = _fit_line(place[near], height[near], length, tolerance)
    behind = (height - offset - slope * place) / np.hypot(1.0, slope)
    with np.errstate(invalid="ignore"):
        on = (np.abs(behind) <= MAX_INLIER_SIGMAS * sigma) & (np.abs(place) < length / 2 + tolerance)
        past = ~(
            behind <= MIN_OTHER_OBJECT_M + MAX_INLIER_SIGMAS * sigma
        )  # a ray without a return has passed the pattern
        inner = np.abs(_ray_crossings(points, ends.mean(0), along, away, offset, slope)) < length / 2 - tolerance
    run = _longest_run(on)
    if len(run) < LEAST_POINTS:
        return NotDetected(f"{len(run)} points on a line, at least {LEAST_POINTS} are needed")
    if (past & inner).sum() > SEE_THROUGH * inner.sum():
        return NotDetected("what is seen where the pattern is expected is no board of its size: rays go past it")
    limits = [
        end for end, beyond in ((run[0], run[0] - 1), (run[-1], run[-1] + 1)) if 0 <= beyond < len(on) and past[beyond]
    ]
    return PatternPoints(run, np.unique(np.array(limits, np.int64)))


def _fit_line(place: Array, height: Array, length: float, tolerance: float) -> tuple[float, float, float]:
    """Fit the line ``height = offset + slope * place`` with most points, and their standard deviation about it."""
    scale = length / 2
    basis = np.stack([np.ones_like(place), place / scale], -1)
    line, sigma = agreed_fit(basis, height, tolerance)
    for _ in range(5):
        residual = height - basis @ line
        on = np.abs(residual) <= MAX_INLIER_SIGMAS * sigma
        if on.sum() < LEAST_POINTS:
            break
        sigma = min(max(1.4826 * median(np.abs(residual[on])), LEAST_SIGMA), tolerance / MAX_INLIER_SIGMAS)
        line = line + np.linalg.lstsq(basis[on], residual[on], rcond=None)[0]
    return float(line[0]), float(line[1] / scale), sigma


def _ray_crossings(points: Array, middle: Array, along: Array, away: Array, offset: float, slope: float) -> Array:
    """Return the intersections (N,) of the rays with a line, along it; NaN without a return or an intersection."""
    x, y = points[:, :2] @ along, points[:, :2] @ away
    x0, y0 = -middle @ along, -middle @ away  # origin of the sensor
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (offset + slope * x0 - y0) / (y - slope * x)
        crossing: Array = np.where(reach > 0, x0 + reach * x, np.nan)
    return crossing


def _longest_run(on: BoolArray) -> IntArray:
    """Return the set indices of the run that has most of them; see `MAX_MISSING_RAYS`."""
    index = np.flatnonzero(on)
    return max(np.split(index, np.flatnonzero(np.diff(index) > MAX_MISSING_RAYS) + 1), key=len)
