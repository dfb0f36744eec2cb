"""Detection of a pattern in a LiDAR's cloud: its points on the pattern, and those on its border.

The LiDAR rotates about the z axis of its frame: the points of one ring have the same polar angle, and
are adjacent in azimuth.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.residuals.border_rays import RING_GAP
from calibration.engine.estimation.residuals.median import median
from calibration.robot.labelling.board_plane import BORDER_END_M, BORDER_SLACK_M, LEAST_POINTS, find_board
from calibration.robot.labelling.detection import NotDetected

LEAST_RINGS = 2
"""The points of one ring are collinear and determine no plane."""
MAX_NEIGHBOUR_STEPS = 1.5
"""Rays of a ring are neighbours if they are closer than this multiple of its step."""
AROUND_BORDER_M = 0.3
"""m: rays that intersect the board's plane up to this distance beyond its border are included."""
DEFAULT_TOLERANCE_M = 0.1
"""m: default limit of a board's distance from its expected position."""


@dataclass(frozen=True, eq=False)
class PatternPoints:
    """Points of a LiDAR or a depth camera on a pattern.

    Indices into the cloud's points; for a depth image the linear index ``y * width + x`` of pixels.
    Ascending, each once.
    """

    on_pattern: IntArray
    """(N,)."""
    on_border: IntArray
    """(L,): those of `on_pattern` on the pattern's physical border."""


def label_points(
    points: Array, pattern: Pattern, T_sensor_pattern: Array, tolerance: float = DEFAULT_TOLERANCE_M
) -> PatternPoints | NotDetected:
    """Find the points of a cloud on a pattern, by a search for its plane.

    Walls, ground or boxes that intersect the plane are excluded: only the part that a board of this size covers counts,
    at the position that explains best which rays end on the plane and which pass.

    The first and the last point of each ring there are on the border (ATOM's rule), unless a nearer object
    occludes what is beyond, the ring continues in the plane, or the point is well inside of the
    border estimated from the other points.

    Args:
        points: (N, 3) in the sensor's frame, m, in any order; NaN without a return.
        pattern: its geometry.
        T_sensor_pattern: (4, 4), expected pose of the pattern, such as from a camera and an initial guess.
        tolerance: limit of the distance of any point of the board from its expected position, m.
    """
    points = np.asarray(points, float)
    board = find_board(points, pattern.outline, T_sensor_pattern, tolerance)
    if isinstance(board, NotDetected):
        return board
    behind, crossing = board.behind(points), board.crossing(points)
    inside = board.inside(crossing)
    if reason := board.absent(behind, inside, sure=tolerance / 4):
        return NotDetected(reason)
    (around,) = np.nonzero((inside > -AROUND_BORDER_M) & np.isfinite(behind))
    rings = _sort_rings(points[around], board.middle)
    steps = np.concatenate([np.diff(azimuth) for _, azimuth in rings])
    beside = MAX_NEIGHBOUR_STEPS * median(steps)
    runs, ends = [], []
    for order, azimuth in rings:
        ray = around[order]
        (part,) = np.nonzero(board.on_plane(points[ray]) & (inside[ray] > -BORDER_SLACK_M))
        if len(part):
            runs.append(ray[part])
            ends += [
                ray[end]
                for end in _border_ends(part, azimuth, crossing[ray], inside[ray], board.passed(behind[ray]), beside)
            ]
    count = sum(map(len, runs))
    if count < LEAST_POINTS or len(runs) < LEAST_RINGS:
        return NotDetected(f"{count} points on {len(runs)} rings, at least {LEAST_POINTS} on {LEAST_RINGS} are needed")
    return PatternPoints(np.sort(np.concatenate(runs)), np.unique(np.array(ends, np.int64)))


def _sort_rings(points: Array, middle: Array) -> list[tuple[IntArray, Array]]:
    """Return the points of each ring sorted by azimuth, and that azimuth, from behind the board's centre (3,)."""
    polar = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    order = np.argsort(polar, kind="stable")
    seam = np.arctan2(-middle[1], -middle[0])
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]) - seam, 2 * np.pi)
    rings = np.split(order, np.flatnonzero(np.diff(polar[order]) > RING_GAP) + 1)
    rings = [ring[np.argsort(azimuth[ring], kind="stable")] for ring in rings]
    return [(ring, azimuth[ring]) for ring in rings]


def _border_ends(
    part: IntArray, azimuth: Array, crossing: Array, inside: Array, passed: BoolArray, beside: float
) -> list[int]:
    """Return those ends of a ring's part on the board that are on the border: see `label_points`."""
    spacing = median(np.linalg.norm(np.diff(crossing[part], axis=0), axis=-1)) if len(part) > 1 else 0.0
    ends = []
    for end, beyond in ((part[0], part[0] - 1), (part[-1], part[-1] + 1)):
        neighbour = 0 <= beyond < len(azimuth) and abs(azimuth[beyond] - azimuth[end]) < beside
        if (passed[beyond] if neighbour else True) and inside[end] < BORDER_END_M + 2 * spacing:
            ends.append(int(end))
    return ends
