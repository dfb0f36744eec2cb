"""A board among other rectangles, and what rays of a LiDAR or a depth camera measure of them."""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, transform, translation
from tests.robot.labelling.pictures import charuco

BOARD: Pattern = charuco().pattern()
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A pattern that a LiDAR has ahead of it, x to the right."""


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A thing without thickness: a rectangle about the origin of its frame, in its plane z = 0."""

    T_sensor_rectangle: Array
    width: float
    height: float

    def cast(self, directions: Array) -> Array:
        """Distances (...) along directions from the origin; infinite where they miss."""
        T = inverse(self.T_sensor_rectangle)
        d = directions @ T[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -T[2, 3] / d[..., 2]
            at = T[:2, 3] + t[..., None] * d[..., :2]
        hit = (t > 0) & (np.abs(at) < [self.width / 2, self.height / 2]).all(-1)
        return np.where(hit, t, np.inf)


def board(T_sensor_pattern: Array, pattern: Pattern = BOARD) -> Rectangle:
    low, high = pattern.outline.min(0), pattern.outline.max(0)
    return Rectangle(T_sensor_pattern @ translation([*(low + high) / 2, 0.0]), *(high - low))


def standing(azimuth: float, distance: float, turn=(0.0, 0.0, 0.0), height: float = 0.0) -> Array:
    """``T_lidar_pattern``: the board's middle in this direction, turned about its own axes."""
    R = rotations.exp([0, 0, azimuth]) @ AHEAD @ rotations.exp(turn)
    middle = distance * np.array([np.cos(azimuth), np.sin(azimuth), height])
    return transform(R, middle - R @ np.array([*BOARD.outline.mean(0), 0.0]))


def upright(azimuth: float, distance: float, width: float, height: float, turn=(0.0, 0.0, 0.0)) -> Rectangle:
    """A rectangle whose middle is in this direction, facing the sensor."""
    return Rectangle(board(standing(azimuth, distance, turn)).T_sensor_rectangle, width, height)


def displaced(T_sensor_pattern: Array, shift: Array, turn: Array) -> Array:
    """A wrong guess: the board moved and turned about its middle."""
    about = translation([*BOARD.outline.mean(0), 0.0])
    return T_sensor_pattern @ about @ transform(rotations.exp(turn), shift) @ inverse(about)


def lidar_rays(rings: int = 16, azimuths: int = 1800, up: float = 15.0) -> Array:
    """(rings, azimuths, 3), unit."""
    elevation = np.radians(np.linspace(-up, up, rings))[:, None]
    azimuth = -np.pi + 2 * np.pi * np.arange(azimuths) / azimuths
    z = np.broadcast_to(np.sin(elevation), (rings, azimuths))
    return np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), z], -1)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured returns; the first two axes are those of the rays."""

    distances: Array
    """Along the rays; NaN for nothing."""
    on_board: BoolArray
    crosses: BoolArray
    """Whether the board is on the ray's way, seen or hidden."""


def measure(rays: Array, pattern: Rectangle, others: list[Rectangle], noise: float, seed: int = 0) -> Measured:
    to_board = pattern.cast(rays)
    nearest = np.min([to_board, *(other.cast(rays) for other in others)], axis=0)
    noisy = nearest + noise * np.random.default_rng(seed).standard_normal(nearest.shape)
    return Measured(
        np.where(np.isfinite(nearest), noisy, np.nan),
        np.isfinite(to_board) & (nearest == to_board),
        np.isfinite(to_board),
    )


def true_border(measured: Measured) -> set[tuple[int, int]]:
    """The ends of each ring (ring, azimuth) on the board: seen, and the next ray outwards misses the board."""
    ends = set()
    azimuths = measured.on_board.shape[1]
    for ring in range(len(measured.on_board)):
        for step in (-1, 1):
            beyond = np.roll(measured.crosses[ring], -step)
            ends |= {(ring, int(a)) for a in np.flatnonzero(measured.on_board[ring] & ~beyond)}
    assert all(0 <= a < azimuths for _, a in ends)
    return ends
