"""Detection of a pattern in a LiDAR's cloud: the board's plane and pose, its points, and those on its border.

The search for the plane begins at an expected pose. It is deterministic: it starts from planes parallel to the expected
one and converges on the points that agree, so the same points always give the same plane.

The LiDAR rotates about the z axis of its frame: the points of one ring have the same polar angle, and
are adjacent in azimuth.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.residuals.ray_residuals import RING_GAP
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, inverse, transform
from calibration.engine.statistics import median
from calibration.robot.labelling.detection import NotDetected

LEAST_POINTS = 10
"""Minimum of a sensor's points on a pattern (ATOM's rule)."""
MAX_INLIER_SIGMAS = 3.5
"""Distance of inliers from the plane, in standard deviations."""
LEAST_SIGMA = 0.001
"""m: lower limit of the points' standard deviation about the plane: boards are not flatter."""
MIN_OTHER_OBJECT_M = 0.02
"""m: distance from the plane, beyond the noise, from which on a point is on another object."""
SEE_THROUGH = 0.2
"""Limit of the share of rays that end behind a board; with more, there is no board."""
MAX_HIDDEN_SHARE = 0.75
"""Limit of the share of rays that end in front of a board; with more, it is occluded."""
BORDER_SLACK_M = 0.01
"""m: points up to this distance beyond the estimated border belong to the board."""
BORDER_END_M = 0.03
"""m: what ends within this distance inside of the estimated border, plus two steps of the sensor, ends on it."""
POINTS_PER_BLOCK = 128
"""Number of points that are counted at once."""
MAX_TURN = np.radians(6)
"""Limit of the rotation in the plane from the expected pose."""


@dataclass(frozen=True, eq=False)
class BoardPlane:
    """Fitted plane and pose of a board."""

    T_sensor_board: Array
    """(4, 4): pose of the pattern's frame; in the plane only as accurate as the border determines it."""
    sigma: float
    """Standard deviation of points about the plane, m."""
    outline: Array
    """(4, 2): `calibration.engine.dataset.pattern.Pattern.outline`."""

    @property
    def middle(self) -> Array:
        """Centre of the board in the sensor's frame (3,)."""
        middle: Array = apply(self.T_sensor_board, np.array([[*self.outline.mean(axis=0), 0.0]]))[0]
        return middle

    def behind(self, points: Array) -> Array:
        """Distance of points (..., N, 3) in the sensor's frame behind the plane, seen from the sensor, m."""
        normal = self.T_sensor_board[:3, 2]
        offset = normal @ self.T_sensor_board[:3, 3]
        return (points @ normal - offset) * (1.0 if offset > 0 else -1.0)

    def on_plane(self, points: Array) -> BoolArray:
        """Return a mask of the points (..., N, 3) on the plane; False for NaN."""
        return np.abs(self.behind(points)) <= MAX_INLIER_SIGMAS * self.sigma

    def crossing(self, points: Array) -> Array:
        """Return where the rays to points (N, 3) intersect the plane (N, 2), in the board's frame; NaN if nowhere."""
        T_board_sensor = inverse(self.T_sensor_board)
        origin = T_board_sensor[:3, 3]
        direction = points @ T_board_sensor[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = -origin[2] / direction[:, 2]
            crossing: Array = np.where(reach[:, None] > 0, origin[:2] + reach[:, None] * direction[:, :2], np.nan)
        return crossing

    def passed(self, behind: Array) -> BoolArray:
        """Return a mask of the points clearly behind the plane, by their distance `behind` it."""
        return behind > MIN_OTHER_OBJECT_M + MAX_INLIER_SIGMAS * self.sigma

    def absent(self, behind: Array, inside: Array, sure: float) -> str:
        """Return the reason why the board is not visible, by the rays that cross it; empty if it is.

        Args:
            behind: (N,), distance of their ends behind the plane, m.
            inside: (N,), distance of their intersections inside of the border, m.
            sure: distance inside of the border from which on a ray surely hits the board, m.
        """
        crossing = behind[inside > sure]
        if self.passed(crossing).sum() > SEE_THROUGH * len(crossing):
            return "what is seen where the pattern is expected is no board of its size: rays go past it"
        if self.passed(-crossing).sum() > MAX_HIDDEN_SHARE * len(crossing):
            return "the pattern is hidden"
        return ""

    def inside(self, places: Array) -> Array:
        """Return the distance of positions (..., 2) in the plane inside of the border, m; negative outside."""
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        within: Array = np.minimum(places - low, high - places).min(-1)
        return within


def find_board(points: Array, outline: Array, T_sensor_pattern: Array, tolerance: float) -> BoardPlane | NotDetected:
    """Find the plane and the pose of a board.

    Args:
        points: (N, 3) in the sensor's frame, m; NaN without a return.
        outline: (4, 2), the board's border in the pattern's frame.
        T_sensor_pattern: (4, 4), expected pose of the board.
        tolerance: limit of the distance of any point of the board from its expected position, m.
    """
    local = apply(inverse(T_sensor_pattern), points)
    low, high = outline.min(axis=0), outline.max(axis=0)
    with np.errstate(invalid="ignore"):
        near = (local[:, :2] > low - tolerance) & (local[:, :2] < high + tolerance)
        chosen = near.all(-1) & (np.abs(local[:, 2]) < tolerance)
    if chosen.sum() < LEAST_POINTS:
        return NotDetected(f"{chosen.sum()} points where the pattern is expected, at least {LEAST_POINTS} are needed")
    found = _find_plane(local[chosen], outline.mean(axis=0), tolerance)
    if found is None:
        return NotDetected("the points where the pattern is expected lie on no plane")
    T_pattern_plane, sigma = found
    plane = BoardPlane(T_sensor_pattern @ T_pattern_plane, sigma, outline)
    places = plane.crossing(points)
    around = plane.inside(places) > -2 * tolerance
    behind = plane.behind(points[around])
    on, beyond = np.abs(behind) <= MAX_INLIER_SIGMAS * sigma, plane.passed(behind)
    if on.sum() < LEAST_POINTS:
        return NotDetected(f"{on.sum()} points on a plane, at least {LEAST_POINTS} are needed")
    T_plane_board = _place_in_plane(places[around][on], places[around][beyond], outline, tolerance)
    return BoardPlane(plane.T_sensor_board @ T_plane_board, sigma, outline)


def _find_plane(points: Array, centre: Array, tolerance: float) -> tuple[Array, float] | None:
    """Find the plane near z = 0 with most points, and the standard deviation of its points about it.

    Returns:
        A frame (4, 4) whose z = 0 is the plane, rotated and moved as little as possible; or None.
    """
    x, y = (points[:, :2] - centre).T
    scale = max(np.abs(x).max(), np.abs(y).max())
    (a, b, c), sigma = agreed_fit(np.stack([np.ones_like(x), x / scale, y / scale], -1), points[:, 2], tolerance)
    if np.hypot(b, c) / scale > 1:
        return None
    T = _frame_of_plane(np.array([-b / scale, -c / scale, 1.0]), np.array([*centre, a]), centre)
    for _ in range(5):
        distance = points @ T[:3, 2] - T[:3, 2] @ T[:3, 3]
        on = np.abs(distance) <= MAX_INLIER_SIGMAS * sigma
        if on.sum() < LEAST_POINTS:
            return None
        sigma = min(max(1.4826 * median(np.abs(distance[on])), LEAST_SIGMA), tolerance / MAX_INLIER_SIGMAS)
        middle = points[on].mean(axis=0)
        normal = np.linalg.eigh((points[on] - middle).T @ (points[on] - middle))[1][:, 0]
        T = _frame_of_plane(normal * np.sign(normal[2]), middle, centre)
    return T, sigma


def agreed_fit(basis: Array, heights: Array, tolerance: float) -> tuple[Array, float]:
    """Fit ``heights = basis @ x`` to most of N points.

    Iterated weighted least squares with Tukey's weights of decreasing width, from several initial heights.

    Args:
        basis: (N, K): 1, and the positions that slopes belong to, from -1 to 1.
        heights: (N,), m.
        tolerance: limit of their distance from the expected height 0, m.

    Returns:
        x (K,), the height and slopes, and a first standard deviation of the points that agree, m.
    """
    count = basis.shape[1]
    products = (basis[:, :, None] * basis[:, None]).reshape(-1, count**2)
    fits = np.zeros((9, count))
    fits[:, 0] = np.linspace(-0.8, 0.8, 9) * tolerance
    hold = np.diag([1e-9, *[1e-3] * (count - 1)])  # regularises slopes that collinear points do not determine
    width = tolerance / 2
    for _ in range(12):
        residual = heights - fits @ basis.T  # (9, N)
        weight = np.clip(1 - (residual / width) ** 2, 0, None) ** 2
        moments = (weight @ products).reshape(9, count, count) + hold
        fits = fits + np.linalg.solve(moments, ((weight * residual) @ basis)[..., None])[..., 0]
        width = max(0.8 * width, tolerance / 6)
    agreeing = (np.clip(1 - ((heights - fits @ basis.T) / width) ** 2, 0, None) ** 2).sum(-1)
    return fits[agreeing.argmax()], width / MAX_INLIER_SIGMAS


def _frame_of_plane(normal: Array, point: Array, centre: Array) -> Array:
    """Return the frame of a plane: rotated as little as possible, with its origin below the given centre."""
    n = normal / np.linalg.norm(normal)
    axis = np.array([-n[1], n[0], 0.0])  # z cross n
    sine = np.linalg.norm(axis)
    R = rotations.exp(axis * (np.arctan2(sine, n[2]) / sine if sine > 1e-12 else 1.0))
    above = np.array([*centre, (n @ point - n[:2] @ centre) / n[2]])
    return transform(R, above - R @ np.array([*centre, 0.0]))


def _place_in_plane(on: Array, beyond: Array, outline: Array, tolerance: float) -> Array:
    """Find the motion (4, 4) in the plane that explains the rays best.

    The score is the number of points on the plane (N, 2) inside of the border, minus the number of intersections
    (M, 2) of rays that end behind it. Occluded rays are ignored. If several motions have the best score, as all between
    one ray and the next, it is the one in the middle. First in coarse steps, then in fine ones.
    """
    points = np.concatenate([on, beyond])
    votes = np.repeat([1.0, -1.0], [len(on), len(beyond)])
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    turn = min(MAX_TURN, tolerance / float(np.linalg.norm(half)))
    angle, shift = 0.0, np.zeros(2)
    for reach in (1.0, 0.5, 0.25, 0.1, 0.04):
        # only points this close to the border can enter or leave it
        away = np.abs(np.abs((points - middle) @ _rotation_matrix(angle) - shift) - half)
        near = away.min(axis=-1) < reach * (tolerance + turn * float(np.linalg.norm(half)))
        angles = angle + np.linspace(-turn, turn, 17) * reach
        steps = np.linspace(-tolerance, tolerance, 21) * reach
        counts = np.stack(
            [_count_votes(points[near] - middle, votes[near], each, shift, half, steps) for each in angles]
        )
        best = np.argwhere(counts >= counts.max() - 0.5)
        scatter = (best - best.mean(axis=0)) / counts.shape
        i, j, k = best[(scatter**2).sum(axis=-1).argmin()]  # the solution closest to their mean
        angle, shift = float(angles[i]), shift + steps[[j, k]]
    R = _rotation_matrix(angle)
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = R, middle + R @ (shift - middle)
    return T


def _count_votes(points: Array, votes: Array, angle: float, shift: Array, half: Array, steps: Array) -> Array:
    """Return the sum of votes inside of the border (A, A), for each shift along x and each along y."""
    turned = points @ _rotation_matrix(angle) - shift
    x, y = (np.abs(turned[:, k, None] - steps) < half[k] for k in (0, 1))
    blocks = len(points) // POINTS_PER_BLOCK + 1
    weighted, within = np.zeros((2, blocks * POINTS_PER_BLOCK, len(steps)), np.float32)
    weighted[: len(points)], within[: len(points)] = x * votes[:, None], y
    # in blocks: for the whole, BLAS would start threads, which takes longer than the work
    products = weighted.reshape(blocks, POINTS_PER_BLOCK, len(steps)).swapaxes(1, 2) @ within.reshape(
        blocks, POINTS_PER_BLOCK, len(steps)
    )
    counts: Array = products.sum(axis=0, dtype=float)
    return counts


def _rotation_matrix(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


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
