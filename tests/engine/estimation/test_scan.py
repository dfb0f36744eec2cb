"""Rays to the border: half a step of the scan beyond the last points on the pattern."""

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.estimation.residuals.ray_residuals import scan_border_rays
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import transform
from tests.engine.estimation.scenes import board, scan, true_values
from tests.engine.estimation.systems import camera_and_lidar

BOARD = board(square=0.12)
FACING = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A pattern that a LiDAR has ahead of it, x to the right."""


def standing(azimuth: float, seed: int, tilt: float = 0.5) -> Array:
    """``T_lidar_pattern``: about 2 m away in this direction, tilted and turned somewhat."""
    rng = np.random.default_rng(seed)
    R = rotations.exp([0, 0, azimuth]) @ FACING @ rotations.exp(rng.uniform(-tilt, tilt, 3))
    centre = rng.uniform(1.7, 2.3) * np.array([np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.1, 0.1)])
    return transform(R, centre - R @ BOARD.centre)


def outside(points: Array, T: Array) -> Array:
    """Signed distance (L,) from where rays through points meet the plane to the border, positive outside, m."""
    hits = points * ((T[:3, 2] @ T[:3, 3]) / (points @ T[:3, 2]))[:, None]
    at = (hits - T[:3, 3]) @ T[:3, :2]
    low, high = BOARD.outline.min(0), BOARD.outline.max(0)
    return np.concatenate([low - at, at - high], -1).max(-1)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, np.pi, -np.pi + 0.02, -2.0])
def test_on_average_border_rays_meet_the_border_and_limit_points_lie_inside(azimuth):
    """Also across the seam, where azimuths jump from pi to -pi."""
    limits, rays = [], []
    for seed in range(60):
        T = standing(azimuth, seed)
        label = scan(BOARD, T, np.random.default_rng(seed), noise=0.005)
        limits.append(outside(label.points[label.limits], T))
        found = scan_border_rays(label.points, label.limits)
        rays.append(outside(found[np.isfinite(found[:, 0])], T))
    inside, between = np.concatenate(limits), np.concatenate(rays)
    half_step = 0.5 * 2.0 * np.radians(0.4)
    assert (inside < 1e-9).all()
    assert inside.mean() < -0.4 * half_step
    # uniform over a step: its mean over n limits has a standard deviation of step / sqrt(12 n)
    assert abs(between.mean()) < 4 * 2 * half_step / np.sqrt(12 * len(between))
    assert between.max() < 1.6 * half_step


def test_turning_the_lidar_turns_the_rays():
    label = scan(BOARD, standing(0.0, 3), np.random.default_rng(3))
    rays = scan_border_rays(label.points, label.limits)
    for angle in (0.5, np.pi - 0.1, np.pi, -1.0):
        R = rotations.exp([0, 0, angle])
        np.testing.assert_allclose(scan_border_rays(label.points @ R.T, label.limits), rays @ R.T, atol=1e-12)


def test_the_order_of_the_points_does_not_matter():
    label = scan(BOARD, standing(2.0, 4), np.random.default_rng(4), noise=0.01)
    order = np.random.default_rng(5).permutation(len(label.points))
    place = np.argsort(order)
    rays = scan_border_rays(label.points, label.limits)
    np.testing.assert_allclose(scan_border_rays(label.points[order], place[label.limits]), rays, atol=1e-12)


def ring(azimuths: list[float], height: float = 0.0) -> Array:
    a = np.array(azimuths)
    return np.stack([2 * np.cos(a), 2 * np.sin(a), height + 0 * a], -1)


def test_ends_move_outwards_by_half_a_step_and_keep_their_range():
    points = np.concatenate([ring([0.02, 0.0, 0.01, -0.01]), ring([0.3, 0.1, 0.2], height=0.2)])
    rays = scan_border_rays(points, np.array([0, 3, 4, 5]))
    np.testing.assert_allclose(np.arctan2(rays[:, 1], rays[:, 0]), [0.025, -0.015, 0.35, 0.05], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), np.linalg.norm(points[[0, 3, 4, 5]], axis=1))
    np.testing.assert_array_equal(rays[:, 2], points[[0, 3, 4, 5], 2])


def test_limits_within_a_ring_stay_where_they_are():
    points = ring([-0.01, 0.0, 0.01])
    np.testing.assert_allclose(scan_border_rays(points, np.array([1])), points[[1]], atol=1e-12)


def test_a_limit_alone_on_its_ring_is_nan_in_its_place():
    points = np.concatenate([ring([0.0, 0.01]), ring([0.005], height=0.1)])
    rays = scan_border_rays(points, np.array([0, 2, 1]))
    assert np.isnan(rays).all(1).tolist() == [False, True, False]
    assert np.isnan(rays).any(1).tolist() == [False, True, False]


def test_no_limits_give_no_rays():
    assert scan_border_rays(ring([0.0, 0.1]), np.zeros(0, int)).shape == (0, 3)


def test_borders_determine_what_planes_leave_open():
    """With the pattern's pose known, rays to its border find the truth to a fraction of a step of the scan."""
    dataset = camera_and_lidar(12, range_noise=0.005).dataset()
    setup = build(dataset)
    _, border = next(group for group in setup.problem.groups if group.sensor == "lidar").terms
    T = setup.problem.poses(next(g for g in setup.problem.groups if g.sensor == "lidar"), true_values(setup))
    distance = border.magnitudes(T)
    assert np.nanmax(distance) < 0.03
    assert np.sqrt(np.nanmean(distance**2)) < 0.01
