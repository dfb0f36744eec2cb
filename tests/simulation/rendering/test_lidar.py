from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.simulation.collection.lidar_labels import LabelledCloud, label_cloud
from calibration.simulation.random_streams import stream
from calibration.simulation.rendering.lidar import Board, Scan, scan
from calibration.simulation.scene import Box, Scene
from calibration.simulation.sensors import SimulatedLidar

LIDAR = SimulatedLidar(tuple(np.radians(np.linspace(-15, 15, 16))), 1875)
OUTLINE = np.array([[-0.04, -0.03], [0.76, -0.03], [0.76, 0.57], [-0.04, 0.57]])
T_WORLD_LIDAR = from_xyz_rpy([0.1, -0.2, 1.6], [0.02, 0.3, 0.5])
ROOM = Scene(ground=0.0, boxes=(Box(from_xyz_rpy([6, 0, 1.5], [0, 0, 0]), np.array([0.2, 9, 3])),))
TILTED = from_xyz_rpy([1.9, 1.0, 1.5], [-1.4, 0.1, -0.8])
"""A board some 2 m in front of the LiDAR, tilted and turned."""


def collect(T_world_pattern: np.ndarray, noise: float = 0.008, scene: Scene = ROOM, seed: int = 0) -> LabelledCloud:
    lidar = replace(LIDAR, noise=noise, resolution=0.001 if noise else 0.0)
    boards = [Board(T_world_pattern, OUTLINE)]
    return label_cloud(lidar, scan(lidar, T_WORLD_LIDAR, scene, boards, stream(seed)), boards, T_WORLD_LIDAR)


def on_board(cloud: LabelledCloud, index: np.ndarray, T_world_pattern: np.ndarray) -> np.ndarray:
    return apply(inverse(T_world_pattern) @ T_WORLD_LIDAR, cloud.points[index])


def test_directions_are_those_of_a_velodyne() -> None:
    rays = LIDAR.directions()
    assert rays.shape == (16, 1875, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1)
    np.testing.assert_allclose(np.degrees(np.arcsin(rays[3, :, 2])), -9)
    azimuth = np.arctan2(rays[8, 1:, 1], rays[8, 1:, 0])
    np.testing.assert_allclose(np.diff(azimuth), 2 * np.pi / 1875, atol=1e-12)


def test_points_lie_on_the_plane_with_the_stated_noise() -> None:
    offsets, sight = [], []
    for seed in range(20):
        cloud = collect(TILTED, seed=seed)
        (labels,) = cloud.patterns
        assert labels is not None
        points = on_board(cloud, labels.on_pattern, TILTED)
        rays = cloud.points[labels.on_pattern]
        normal = (inverse(T_WORLD_LIDAR) @ TILTED)[:3, 2]
        sight.append(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1))
        offsets.append(points[:, 2] / sight[-1])  # along the ray
    error = np.concatenate(offsets)
    assert len(error) > 5000
    assert np.std(error) == pytest.approx(np.hypot(0.008, 0.001 / np.sqrt(12)), rel=0.03)
    assert abs(error.mean()) < 0.0005


def test_ranges_have_the_resolution() -> None:
    cloud = collect(TILTED)
    ranges = np.linalg.norm(cloud.points, axis=-1) * 1000
    np.testing.assert_allclose(ranges, np.round(ranges), atol=2e-3)


def test_border_points_are_inside_and_within_a_step_of_the_border() -> None:
    cloud = collect(TILTED, noise=0.0)
    (labels,) = cloud.patterns
    assert labels is not None
    everything = on_board(cloud, labels.on_pattern, TILTED)
    low, high = OUTLINE.min(0), OUTLINE.max(0)
    assert ((everything[:, :2] > low - 1e-5) & (everything[:, :2] < high + 1e-5)).all()
    points = on_board(cloud, labels.on_border, TILTED)
    assert len(points) >= 12
    # where the plane is met by the ray one step further outwards: beyond the border
    rays = cloud.points[labels.on_border]
    last = np.zeros(len(points), bool)
    for step in (LIDAR.step, -LIDAR.step):
        turned = rays @ from_xyz_rpy([0, 0, 0], [0, 0, step])[:3, :3].T
        origin = apply(inverse(TILTED), T_WORLD_LIDAR[None, :3, 3])
        direction = on_board(replace(cloud, points=turned), np.arange(len(turned)), TILTED) - origin
        met = origin - direction * (origin[:, 2:] / direction[:, 2:])
        last |= ((met[:, :2] < low) | (met[:, :2] > high)).any(-1)
    assert last.all()
    assert set(labels.on_border) <= set(labels.on_pattern)


def test_every_ring_on_the_board_has_its_two_ends() -> None:
    cloud = collect(TILTED, noise=0.0)
    (labels,) = cloud.patterns
    assert labels is not None
    ring = np.round(np.degrees(np.arcsin(cloud.points[:, 2] / np.linalg.norm(cloud.points, axis=-1))))
    azimuth = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    expected = []
    for elevation in np.unique(ring[labels.on_pattern]):
        (of_ring,) = np.nonzero(ring[labels.on_pattern] == elevation)
        index = labels.on_pattern[of_ring]
        expected += [index[azimuth[index].argmin()], index[azimuth[index].argmax()]]
    assert sorted(expected) == sorted(labels.on_border.tolist())


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.9, 3.14159, -2.5])
def test_nothing_happens_at_the_seam(turn: float) -> None:
    """The board turned about the LiDAR's axis: its azimuth does not matter."""
    spin = from_xyz_rpy([0, 0, 0], [0, 0, round(turn / LIDAR.step) * LIDAR.step])
    lidar = replace(LIDAR, noise=0.0, resolution=0.0)
    boards = [Board(T_WORLD_LIDAR @ spin @ inverse(T_WORLD_LIDAR) @ TILTED, OUTLINE)]
    cloud = label_cloud(lidar, scan(lidar, T_WORLD_LIDAR, Scene(), boards, stream(0)), boards, T_WORLD_LIDAR)
    plain = collect(TILTED, noise=0.0, scene=Scene())
    for a, b in zip(cloud.patterns, plain.patterns, strict=True):
        assert a is not None
        assert b is not None
        assert len(a.on_pattern) == len(b.on_pattern)
        turned = apply(spin, plain.points[b.on_border])
        nearest = np.linalg.norm(cloud.points[a.on_border][:, None] - turned, axis=-1).min(0)
        assert nearest.max() < 1e-5


def test_only_the_sector_around_the_board_is_stored() -> None:
    cloud = collect(TILTED)
    corners = apply(inverse(T_WORLD_LIDAR) @ TILTED, np.column_stack([OUTLINE, np.zeros(4)]))
    azimuth = np.degrees(np.arctan2(cloud.points[:, 1], cloud.points[:, 0]))
    edge = np.degrees(np.arctan2(corners[:, 1], corners[:, 0]))
    reach = max(edge.max() - np.mean(edge), np.mean(edge) - edge.min()) + 10
    assert np.abs(azimuth - np.mean(edge)).max() < reach
    (labels,) = cloud.patterns
    assert labels is not None
    assert len(labels.on_pattern) < len(cloud.points)


def test_something_in_front_hides_points_and_makes_no_border() -> None:
    middle = apply(TILTED, np.array([[0.9, 0.27, 0.0]]))[0]
    between = T_WORLD_LIDAR[:3, 3] + 0.6 * (middle - T_WORLD_LIDAR[:3, 3])
    box = Box(from_xyz_rpy(between, [0, 0, 0]), np.full(3, 0.25))
    free, hidden = collect(TILTED, 0.0), collect(TILTED, 0.0, Scene(ground=0.0, boxes=(*ROOM.boxes, box)))
    (a,), (b,) = free.patterns, hidden.patterns
    assert a is not None
    assert b is not None
    assert 10 < len(b.on_pattern) < len(a.on_pattern)
    assert len(b.on_border) < len(a.on_border)
    border = {tuple(point) for point in free.points[a.on_border]}
    assert {tuple(point) for point in hidden.points[b.on_border]} < border


def test_a_board_out_of_reach_is_not_detected_and_its_sector_is_stored() -> None:
    overhead = from_xyz_rpy([1.0, 0.5, 4.0], [0, 0, 0])
    cloud = collect(overhead)
    assert cloud.patterns == (None,)
    assert len(cloud.points) > 100


def test_one_ring_is_no_detection() -> None:
    x, y, z = apply(inverse(T_WORLD_LIDAR) @ TILTED, np.array([[0.36, 0.27, 0]]))[0]
    lidar = replace(LIDAR, elevations=(float(np.arctan2(z, np.hypot(x, y))),))
    boards = [Board(TILTED, OUTLINE)]
    one = scan(lidar, T_WORLD_LIDAR, ROOM, boards, stream(0))
    assert (one.board == 0).sum() > 20
    assert label_cloud(lidar, one, boards, T_WORLD_LIDAR).patterns == (None,)


def test_range_limits() -> None:
    boards = [Board(TILTED, OUTLINE)]
    short = scan(replace(LIDAR, least_range=4.0), T_WORLD_LIDAR, ROOM, boards, stream(0))
    assert (short.board == -1).all()
    assert (short.crossed == 0).any()
    assert not short.returns[short.crossed == 0].any()  # it is too near, and still in the way
    near = scan(replace(LIDAR, most_range=3.0), T_WORLD_LIDAR, ROOM, boards, stream(0))
    assert near.ranges[near.returns].max() < 3.1


def test_two_boards_the_nearer_one_hides_the_other() -> None:
    behind = TILTED.copy()
    behind[:3, 3] += 0.2 * (TILTED[:3, 3] - T_WORLD_LIDAR[:3, 3]) + 0.4 * TILTED[:3, 0]
    far: Scan = scan(LIDAR, T_WORLD_LIDAR, ROOM, [Board(behind, OUTLINE)], stream(0))
    both: Scan = scan(LIDAR, T_WORLD_LIDAR, ROOM, [Board(behind, OUTLINE), Board(TILTED, OUTLINE)], stream(0))
    assert 0 < (both.board == 0).sum() < (far.board == 0).sum()
    assert (both.board == 1).sum() > 100


def test_the_noise_of_a_ray_does_not_depend_on_what_others_hit() -> None:
    with_board = scan(LIDAR, T_WORLD_LIDAR, ROOM, [Board(TILTED, OUTLINE)], stream(0))
    without = scan(LIDAR, T_WORLD_LIDAR, ROOM, [], stream(0))
    np.testing.assert_array_equal(with_board.ranges[with_board.board < 0], without.ranges[with_board.board < 0])
