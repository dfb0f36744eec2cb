"""The plane of a board among measured points, and the board's place in it, from a rough idea of both.

Nothing is drawn at random: the search starts from planes parallel to the expected one and narrows
down on the points that agree, so the same points give the same plane.
"""

from dataclasses import dataclass

import numpy as np

from calibration.estimation.median import median
from calibration.geometry import rotations
from calibration.geometry.transforms import apply, inverse, transform
from calibration.geometry.types import Array, BoolArray
from calibration.labelling.detection import NotDetected

LEAST_POINTS = 10
"""Of a sensor on a pattern (ATOM's rule)."""
INLIER = 3.5
"""A point lies on the plane when it is nearer than so many standard deviations."""
LEAST_SIGMA = 0.001
"""Of points about the plane (m), however exact they seem: boards are not flat to less."""
CLEAR = 0.02
"""What is off the plane by more than its points' noise and this is something else, m."""
SEE_THROUGH = 0.2
"""The share of rays that may come back from behind a board; more, and it does not stand there."""
HIDDEN = 0.75
"""The share of rays that may come back from in front of a board; more, and it is hidden."""
SLACK = 0.01
"""A point belongs to the board up to so far beyond where its border is found, m."""
END = 0.03
"""What ends at most so far within where the border is found, and two steps of the sensor, ends on the border, m."""
BLOCK = 128
"""Points that are counted at once."""
TURN = np.radians(6)
"""How far a board is turned in its plane, at most, against what is expected."""


@dataclass(frozen=True, eq=False)
class BoardPlane:
    """Where a board is found."""

    T_sensor_board: Array
    """(4, 4): the pattern's frame as the points have it; along its plane only as well as its border tells."""
    sigma: float
    """The standard deviation of points about the plane, m."""
    outline: Array
    """(4, 2): `calibration.dataset.pattern.Pattern.outline`."""

    @property
    def middle(self) -> Array:
        """(3,): the middle of the board in the sensor's frame."""
        middle: Array = apply(self.T_sensor_board, np.array([[*self.outline.mean(axis=0), 0.0]]))[0]
        return middle

    def behind(self, points: Array) -> Array:
        """How far points (..., N, 3) in the sensor's frame lie behind the plane, seen from the sensor, m."""
        normal = self.T_sensor_board[:3, 2]
        offset = normal @ self.T_sensor_board[:3, 3]
        away: Array = (points @ normal - offset) * (1.0 if offset > 0 else -1.0)
        return away

    def on_plane(self, points: Array) -> BoolArray:
        """Which points (..., N, 3) lie on the plane, NaN excluded."""
        on: BoolArray = np.abs(self.behind(points)) <= INLIER * self.sigma
        return on

    def crossing(self, points: Array) -> Array:
        """Where the rays to points (N, 3) cross the plane, (N, 2) in the board's frame; NaN where they do not."""
        T_board_sensor = inverse(self.T_sensor_board)
        origin = T_board_sensor[:3, 3]
        direction = points @ T_board_sensor[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = -origin[2] / direction[:, 2]
            crossing: Array = np.where(reach[:, None] > 0, origin[:2] + reach[:, None] * direction[:, :2], np.nan)
        return crossing

    def in_front(self, behind: Array) -> BoolArray:
        """Which points end clearly before the plane, by how far `behind` it they are."""
        return behind < -(CLEAR + INLIER * self.sigma)

    def passed(self, behind: Array) -> BoolArray:
        """Which points end clearly beyond the plane, by how far `behind` it they are."""
        return behind > CLEAR + INLIER * self.sigma

    def absent(self, behind: Array, inside: Array, sure: float) -> str:
        """Why the rays that cross the board say that it is not there, or nothing.

        Args:
            behind: (N,), how far behind the plane they end, m.
            inside: (N,), how far within the border they cross it, m.
            sure: how far within the border a ray crosses that surely meets the board, m.
        """
        crossing = behind[inside > sure]
        if self.passed(crossing).sum() > SEE_THROUGH * len(crossing):
            return "what is seen where the pattern is expected is no board of its size: rays go past it"
        if self.in_front(crossing).sum() > HIDDEN * len(crossing):
            return "the pattern is hidden"
        return ""

    def inside(self, places: Array) -> Array:
        """How far places (..., 2) of the plane lie within the border, m; negative outside."""
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        within: Array = np.minimum(places - low, high - places).min(-1)
        return within


def find_board(points: Array, outline: Array, T_sensor_pattern: Array, tolerance: float) -> BoardPlane | NotDetected:
    """The board's plane and place.

    Args:
        points: (N, 3) in the sensor's frame, m; NaN where nothing came back.
        outline: (4, 2), the board's border in the pattern's frame.
        T_sensor_pattern: (4, 4), where the board is expected.
        tolerance: how far, at most, any place of the board is from where it is expected, m.
    """
    local = apply(inverse(T_sensor_pattern), points)
    low, high = outline.min(axis=0), outline.max(axis=0)
    with np.errstate(invalid="ignore"):
        near = (local[:, :2] > low - tolerance) & (local[:, :2] < high + tolerance)
        chosen = near.all(-1) & (np.abs(local[:, 2]) < tolerance)
    if chosen.sum() < LEAST_POINTS:
        return NotDetected(f"{chosen.sum()} points where the pattern is expected, at least {LEAST_POINTS} are needed")
    found = _plane(local[chosen], outline.mean(axis=0), tolerance)
    if found is None:
        return NotDetected("the points where the pattern is expected lie on no plane")
    T_pattern_plane, sigma = found
    plane = BoardPlane(T_sensor_pattern @ T_pattern_plane, sigma, outline)
    places = plane.crossing(points)
    around = plane.inside(places) > -2 * tolerance
    behind = plane.behind(points[around])
    on, beyond = np.abs(behind) <= INLIER * sigma, plane.passed(behind)
    if on.sum() < LEAST_POINTS:
        return NotDetected(f"{on.sum()} points on a plane, at least {LEAST_POINTS} are needed")
    T_plane_board = _placed(places[around][on], places[around][beyond], outline, tolerance)
    return BoardPlane(plane.T_sensor_board @ T_plane_board, sigma, outline)


def _plane(points: Array, centre: Array, tolerance: float) -> tuple[Array, float] | None:
    """The plane with most points that is nearly z = 0, and the standard deviation of its points about it.

    Tukey's weights with a width that shrinks, from several heights at once.

    Returns:
        A frame (4, 4) whose z = 0 is the plane, turned and moved no more than needed; or None.
    """
    x, y = (points[:, :2] - centre).T
    scale = max(np.abs(x).max(), np.abs(y).max())
    basis = np.stack([np.ones_like(x), x / scale, y / scale], -1)
    products = (basis[:, :, None] * basis[:, None]).reshape(-1, 9)
    planes = np.zeros((9, 3))  # height at the centre, and slopes
    planes[:, 0] = np.linspace(-0.8, 0.8, 9) * tolerance
    hold = np.diag([1e-9, 1e-3, 1e-3])  # slopes stay as they are where points on a line leave them open
    width = tolerance / 2
    for _ in range(12):
        residual = points[:, 2] - planes @ basis.T  # (9, N)
        weight = np.clip(1 - (residual / width) ** 2, 0, None) ** 2
        moments = (weight @ products).reshape(9, 3, 3) + hold
        planes = planes + np.linalg.solve(moments, ((weight * residual) @ basis)[..., None])[..., 0]
        width = max(0.8 * width, tolerance / 6)
    residual = points[:, 2] - planes @ basis.T
    agreeing = (np.clip(1 - (residual / width) ** 2, 0, None) ** 2).sum(-1)
    a, b, c = planes[agreeing.argmax()]
    if np.hypot(b, c) / scale > 1:
        return None
    T = _frame(np.array([-b / scale, -c / scale, 1.0]), np.array([*centre, a]), centre)
    sigma = width / INLIER
    for _ in range(5):
        distance = points @ T[:3, 2] - T[:3, 2] @ T[:3, 3]
        on = np.abs(distance) <= INLIER * sigma
        if on.sum() < LEAST_POINTS:
            return None
        sigma = min(max(1.4826 * median(np.abs(distance[on])), LEAST_SIGMA), tolerance / INLIER)
        middle = points[on].mean(axis=0)
        normal = np.linalg.eigh((points[on] - middle).T @ (points[on] - middle))[1][:, 0]
        T = _frame(normal * np.sign(normal[2]), middle, centre)
    return T, sigma


def _frame(normal: Array, point: Array, centre: Array) -> Array:
    """The frame of a plane: turned as little as possible, its origin such that the centre stays above itself."""
    n = normal / np.linalg.norm(normal)
    axis = np.array([-n[1], n[0], 0.0])  # z cross n
    sine = np.linalg.norm(axis)
    R = rotations.exp(axis * (np.arctan2(sine, n[2]) / sine if sine > 1e-12 else 1.0))
    above = np.array([*centre, (n @ point - n[:2] @ centre) / n[2]])
    return transform(R, above - R @ np.array([*centre, 0.0]))


def _placed(on: Array, beyond: Array, outline: Array, tolerance: float) -> Array:
    """The motion (4, 4) in the plane that puts the board where it explains the rays best.

    Best is where most points on the plane (N, 2) lie within its border, less the places (M, 2) where
    rays cross the plane that end beyond it. What is hidden says nothing. Where several motions are
    best, as all between one ray and the next, the one in the middle. Coarse steps, then fine ones.
    """
    points = np.concatenate([on, beyond])
    votes = np.repeat([1.0, -1.0], [len(on), len(beyond)])
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    turn = min(TURN, tolerance / float(np.linalg.norm(half)))
    angle, shift = 0.0, np.zeros(2)
    for reach in (1.0, 0.5, 0.25, 0.1, 0.04):
        # only what is so near to the border can come in or go out
        away = np.abs(np.abs((points - middle) @ _rotation(angle) - shift) - half)
        near = away.min(axis=-1) < reach * (tolerance + turn * float(np.linalg.norm(half)))
        angles = angle + np.linspace(-turn, turn, 17) * reach
        steps = np.linspace(-tolerance, tolerance, 21) * reach
        counts = np.stack([_counts(points[near] - middle, votes[near], each, shift, half, steps) for each in angles])
        best = np.argwhere(counts >= counts.max() - 0.5)
        scatter = (best - best.mean(axis=0)) / counts.shape
        i, j, k = best[(scatter**2).sum(axis=-1).argmin()]  # in the middle, and one of them
        angle, shift = float(angles[i]), shift + steps[[j, k]]
    R = _rotation(angle)
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = R, middle + R @ (shift - middle)
    return T


def _counts(points: Array, votes: Array, angle: float, shift: Array, half: Array, steps: Array) -> Array:
    """The sum of votes within the border (A, A), for each further shift along x and each along y."""
    turned = points @ _rotation(angle) - shift
    x, y = (np.abs(turned[:, k, None] - steps) < half[k] for k in (0, 1))
    blocks = len(points) // BLOCK + 1
    weighted, within = np.zeros((2, blocks * BLOCK, len(steps)), np.float32)
    weighted[: len(points)], within[: len(points)] = x * votes[:, None], y
    # in blocks: for the whole, BLAS would start threads, which takes longer than the work
    products = weighted.reshape(blocks, BLOCK, len(steps)).swapaxes(1, 2) @ within.reshape(blocks, BLOCK, len(steps))
    counts: Array = products.sum(axis=0, dtype=float)
    return counts


def _rotation(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
