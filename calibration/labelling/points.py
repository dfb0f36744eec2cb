"""The points of a LiDAR's cloud that lie on a pattern, and those on its border.

The LiDAR turns about the z axis of its frame: the points of one ring have the same polar angle, and
lie side by side in azimuth.
"""

from dataclasses import dataclass

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.estimation.median import median
from calibration.estimation.scan import RING_GAP
from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.labelling.board_plane import END, LEAST_POINTS, SLACK, find_board
from calibration.labelling.detection import NotDetected

LEAST_RINGS = 2
"""The points of one ring lie on a line, through which no plane is determined."""
BESIDE = 1.5
"""Rays of a ring are neighbours when they are nearer than so many of its steps."""
AROUND = 0.3
"""Rays that cross the board's plane so far beyond its border are looked at too, m."""
TOLERANCE = 0.1
"""How far a board may be from where it is expected, m."""


@dataclass(frozen=True, eq=False)
class PatternPoints:
    """What a LiDAR or a depth camera sees of a pattern.

    Indices into the cloud's points; for a depth image the linear index ``y * width + x`` of pixels.
    Ascending, each once.
    """

    on_pattern: IntArray
    """(N,)."""
    on_border: IntArray
    """(L,): those of `on_pattern` that lie on the pattern's physical border."""


def label_points(
    points: Array, pattern: Pattern, T_sensor_pattern: Array, tolerance: float = TOLERANCE
) -> PatternPoints | NotDetected:
    """The points of a cloud that lie on a pattern, found by a search for its plane.

    Walls, ground or boxes that cross the plane are left out: only the part counts that a board of
    this size covers, placed so that it explains best which rays end on the plane and which go past.

    The first and the last point of each ring there are on the border (ATOM's rule), unless something
    nearer hides what comes beyond, the ring goes on along the plane, or the point lies well inside of
    where the other points put the border.

    Args:
        points: (N, 3) in the sensor's frame, m, in any order; NaN where nothing came back.
        pattern: its geometry.
        T_sensor_pattern: (4, 4), where the pattern is expected, as from a camera and a first guess.
        tolerance: how far, at most, any place of the board is from where it is expected, m.
    """
    points = np.asarray(points, float)
    board = find_board(points, pattern.outline, T_sensor_pattern, tolerance)
    if isinstance(board, NotDetected):
        return board
    behind, crossing = board.behind(points), board.crossing(points)
    inside = board.inside(crossing)
    if reason := board.absent(behind, inside, sure=tolerance / 4):
        return NotDetected(reason)
    (around,) = np.nonzero((inside > -AROUND) & np.isfinite(behind))
    rings = _rings(points[around], board.middle)
    steps = np.concatenate([np.diff(azimuth) for _, azimuth in rings])
    beside = BESIDE * median(steps)
    runs, ends = [], []
    for order, azimuth in rings:
        ray = around[order]
        (part,) = np.nonzero(board.on_plane(points[ray]) & (inside[ray] > -SLACK))
        if len(part):
            runs.append(ray[part])
            ends += [
                ray[end]
                for end in _border(part, azimuth, crossing[ray], inside[ray], board.passed(behind[ray]), beside)
            ]
    count = sum(map(len, runs))
    if count < LEAST_POINTS or len(runs) < LEAST_RINGS:
        return NotDetected(f"{count} points on {len(runs)} rings, at least {LEAST_POINTS} on {LEAST_RINGS} are needed")
    return PatternPoints(np.sort(np.concatenate(runs)), np.unique(np.array(ends, np.int64)))


def _rings(points: Array, middle: Array) -> list[tuple[IntArray, Array]]:
    """The points of each ring in the order of their azimuth, and that azimuth from behind the board's middle (3,)."""
    polar = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    order = np.argsort(polar, kind="stable")
    seam = np.arctan2(-middle[1], -middle[0])
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]) - seam, 2 * np.pi)
    rings = np.split(order, np.flatnonzero(np.diff(polar[order]) > RING_GAP) + 1)
    rings = [ring[np.argsort(azimuth[ring], kind="stable")] for ring in rings]
    return [(ring, azimuth[ring]) for ring in rings]


def _border(
    part: IntArray, azimuth: Array, crossing: Array, inside: Array, passed: BoolArray, beside: float
) -> list[int]:
    """Which of the two ends of the part of a ring that is on the board are on the border: see `label_points`."""
    spacing = median(np.linalg.norm(np.diff(crossing[part], axis=0), axis=-1)) if len(part) > 1 else 0.0
    ends = []
    for end, beyond in ((part[0], part[0] - 1), (part[-1], part[-1] + 1)):
        neighbour = 0 <= beyond < len(azimuth) and abs(azimuth[beyond] - azimuth[end]) < beside
        if (passed[beyond] if neighbour else True) and inside[end] < END + 2 * spacing:
            ends.append(int(end))
    return ends
