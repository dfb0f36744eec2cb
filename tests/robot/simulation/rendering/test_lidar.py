from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board, Box, Scene
from calibration.robot.simulation.sensors import SimulatedLidar
from calibration.robot.simulation.sensors.lidars import Scan
from tests.robot.simulation.rendering.views import CHARUCO

LIDAR = SimulatedLidar(tuple(np.radians(np.linspace(-15, 15, 16))), 1875)
EXACT = replace(LIDAR, noise=0.0, resolution=0.0)
T_WORLD_LIDAR = from_xyz_rpy([0.1, -0.2, 1.6], [0.02, 0.3, 0.5])
ROOM = Scene(ground=0.0, boxes=(Box(from_xyz_rpy([6, 0, 1.5], [0, 0, 0]), np.array([0.2, 9, 3])),))
TILTED = from_xyz_rpy([1.9, 1.0, 1.5], [-1.4, 0.1, -0.8])
"""A board some 2 m in front of the LiDAR, tilted and turned."""


def board(T_world_pattern: np.ndarray = TILTED, bow: tuple[float, float] = (0.0, 0.0)) -> Board:
    return Board(CHARUCO, CHARUCO.pattern(), T_world_pattern, bow)


def scanned(lidar: SimulatedLidar, boards: Sequence[Board], scene: Scene = ROOM, seed: int = 0) -> Scan:
    return lidar.scan(T_WORLD_LIDAR, scene, boards, stream(seed))


def in_pattern(seen: Scan) -> tuple[np.ndarray, np.ndarray]:
    """The points on board 0, and the rays to them, in the frame of the board at TILTED."""
    on_board = seen.board == 0
    rays = LIDAR.directions()[on_board]
    T_pattern_lidar = inverse(TILTED) @ T_WORLD_LIDAR
    return apply(T_pattern_lidar, seen.ranges[on_board, None] * rays), rays @ T_pattern_lidar[:3, :3].T


def test_directions_are_those_of_a_velodyne() -> None:
    rays = LIDAR.directions()
    assert rays.shape == (16, 1875, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1)
    np.testing.assert_allclose(np.degrees(np.arcsin(rays[3, :, 2])), -9)
    azimuth = np.arctan2(rays[8, 1:, 1], rays[8, 1:, 0])
    np.testing.assert_allclose(np.diff(azimuth), 2 * np.pi / 1875, atol=1e-12)


@pytest.mark.parametrize("bow", [(0.0, 0.0), (0.03, -0.02)])
def test_points_lie_on_the_board(bow: tuple[float, float]) -> None:
    pattern = board(bow=bow)
    points, _ = in_pattern(scanned(EXACT, [pattern]))
    assert len(points) > 250
    np.testing.assert_allclose(points, pattern.surface(points[:, :2]), atol=1e-9)
    low, high = pattern.limits
    assert ((points[:, :2] >= low - 1e-9) & (points[:, :2] <= high + 1e-9)).all()


def test_points_have_the_stated_noise_along_the_ray() -> None:
    errors = []
    for seed in range(20):
        points, rays = in_pattern(scanned(LIDAR, [board()], seed=seed))
        errors.append(points[:, 2] / rays[:, 2])
    error = np.concatenate(errors)
    assert len(error) > 5000
    assert np.std(error) == pytest.approx(np.hypot(0.008, 0.001 / np.sqrt(12)), rel=0.03)
    assert abs(error.mean()) < 0.0005


def test_ranges_have_the_resolution() -> None:
    seen = scanned(LIDAR, [board()])
    millimetres = seen.ranges[seen.returns] * 1000
    np.testing.assert_allclose(millimetres, np.round(millimetres), atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.9, 3.14159, -2.5])
def test_nothing_happens_at_the_seam(turn: float) -> None:
    """The board turned about the LiDAR's axis: its azimuth does not matter."""
    steps = round(turn / LIDAR.step)
    spin = from_xyz_rpy([0, 0, 0], [0, 0, steps * LIDAR.step])
    turned = scanned(EXACT, [board(T_WORLD_LIDAR @ spin @ inverse(T_WORLD_LIDAR) @ TILTED)], Scene())
    plain = scanned(EXACT, [board()], Scene())
    np.testing.assert_allclose(np.roll(turned.ranges, -steps, axis=1), plain.ranges, atol=1e-9)


def test_something_in_front_hides_points() -> None:
    middle = apply(TILTED, np.array([[0.9, 0.27, 0.0]]))[0]
    between = T_WORLD_LIDAR[:3, 3] + 0.6 * (middle - T_WORLD_LIDAR[:3, 3])
    box = Box(from_xyz_rpy(between, [0, 0, 0]), np.full(3, 0.25))
    free, hidden = scanned(EXACT, [board()]), scanned(EXACT, [board()], Scene(ground=0.0, boxes=(*ROOM.boxes, box)))
    assert 10 < (hidden.board == 0).sum() < (free.board == 0).sum()
    np.testing.assert_array_equal(free.crossed, hidden.crossed)
    behind = (free.board == 0) & (hidden.board == -1)
    assert (hidden.ranges[behind] < free.ranges[behind]).all()


def test_range_limits() -> None:
    boards = [board()]
    short = replace(LIDAR, reach=(4.0, 130.0)).scan(T_WORLD_LIDAR, ROOM, boards, stream(0))
    assert (short.board == -1).all()
    assert (short.crossed == 0).any()
    assert not short.returns[short.crossed == 0].any()  # it is too near, and still in the way
    near = replace(LIDAR, reach=(0.9, 3.0)).scan(T_WORLD_LIDAR, ROOM, boards, stream(0))
    assert near.ranges[near.returns].max() < 3.1


def test_two_boards_the_nearer_one_hides_the_other() -> None:
    behind = TILTED.copy()
    behind[:3, 3] += 0.2 * (TILTED[:3, 3] - T_WORLD_LIDAR[:3, 3]) + 0.4 * TILTED[:3, 0]
    far: Scan = LIDAR.scan(T_WORLD_LIDAR, ROOM, [board(behind)], stream(0))
    both: Scan = LIDAR.scan(T_WORLD_LIDAR, ROOM, [board(behind), board()], stream(0))
    assert 0 < (both.board == 0).sum() < (far.board == 0).sum()
    assert (both.board == 1).sum() > 100


def test_the_noise_of_a_ray_does_not_depend_on_what_others_hit() -> None:
    with_board = LIDAR.scan(T_WORLD_LIDAR, ROOM, [board()], stream(0))
    without = LIDAR.scan(T_WORLD_LIDAR, ROOM, [], stream(0))
    np.testing.assert_array_equal(with_board.ranges[with_board.board < 0], without.ranges[with_board.board < 0])
