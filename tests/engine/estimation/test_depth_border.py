"""Rays to the border: half a pixel beyond the last pixels on the pattern."""

import numpy as np
import pytest

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.residuals.ray_residuals import PIXELS_ON_EITHER_SIDE, depth_border_rays
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import transform
from tests.engine.estimation.scenes import board

BOARD = board(square=0.12)
CAMERA = Camera(280.0, 285.0, 158.0, 121.0, 320, 240)
BENT = Camera(280.0, 285.0, 158.0, 121.0, 320, 240, PlumbBob(-0.2, 0.05, 0.001, -0.002))


def standing(seed: int, roll: float = np.pi, tilt: float = 0.5) -> Array:
    """``T_camera_pattern``: about 2 m away, tilted and turned somewhat."""
    rng = np.random.default_rng(seed)
    R = rotations.exp([0, 0, rng.uniform(-roll, roll)]) @ rotations.exp([*rng.uniform(-tilt, tilt, 2), 0])
    centre = rng.uniform(1.8, 2.2) * np.array([*rng.uniform(-0.05, 0.05, 2), 1.0])
    return transform(R, centre - R @ BOARD.centre)


def labelled(camera: Camera, T: Array, noise: float = 0.0, seed: int = 0) -> tuple[Array, IntArray]:
    """The points of the pixels whose centre sees the pattern, and which have a neighbour that does not."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.concatenate([camera.normalise(np.stack([u, v], -1).astype(float)), np.ones((*u.shape, 1))], -1)
    points = rays * ((T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2]))[..., None]
    hit = outside(points, T) <= 0
    beside = np.pad(hit, 1)
    inner = beside[:-2, 1:-1] & beside[2:, 1:-1] & beside[1:-1, :-2] & beside[1:-1, 2:]
    scale = 1 + noise * np.random.default_rng(seed).normal(size=hit.sum())
    return points[hit] * scale[:, None], np.flatnonzero(~inner[hit])


def outside(points: Array, T: Array) -> Array:
    """Signed distance (...) from where rays through points meet the plane to the border, positive outside, m."""
    hits = points * ((T[:3, 2] @ T[:3, 3]) / (points @ T[:3, 2]))[..., None]
    at = (hits - T[:3, 3]) @ T[:3, :2]
    low, high = BOARD.outline.min(0), BOARD.outline.max(0)
    return np.concatenate([low - at, at - high], -1).max(-1)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("camera", [CAMERA, BENT])
@pytest.mark.parametrize("roll", [np.pi, 0.03])
def test_on_average_border_rays_meet_the_border_and_limit_points_lie_inside(camera, roll):
    """Also where borders run nearly along rows and columns, so that many pixels in a row err alike."""
    inside, between, kept = [], [], []
    for seed in range(20):
        T = standing(seed, roll, tilt=0.02 if roll < 1 else 0.5)
        points, limits = labelled(camera, T, noise=0.002, seed=seed)
        rays = depth_border_rays(points, limits, camera)
        found = np.isfinite(rays[:, 0])
        inside.append(outside(points[limits], T).mean())
        between.append(outside(rays[found], T).mean())
        kept.append(found.mean())
    pixel = 2.0 / 280
    assert np.mean(inside) < -0.35 * pixel
    assert abs(np.mean(between)) < 0.02 * pixel
    assert np.std(between) < 0.1 * pixel
    assert np.mean(kept) > (0.85 if roll > 1 else 0.1)


def test_the_depth_is_kept_and_the_pixel_moves_by_half_along_one_axis():
    points, limits = labelled(BENT, standing(1), noise=0.002)
    rays = depth_border_rays(points, limits, BENT)
    found = np.isfinite(rays[:, 0])
    np.testing.assert_array_equal(rays[found, 2], points[limits[found], 2])
    moved = np.abs(BENT.project(rays[found]) - BENT.project(points[limits[found]]))
    np.testing.assert_allclose(np.sort(moved, -1), np.broadcast_to([0.0, 0.5], moved.shape), atol=1e-9)


def test_the_order_of_the_points_does_not_matter():
    points, limits = labelled(CAMERA, standing(4))
    order = np.random.default_rng(5).permutation(len(points))
    shuffled = depth_border_rays(points[order], np.argsort(order)[limits], CAMERA)
    np.testing.assert_allclose(shuffled, depth_border_rays(points, limits, CAMERA), atol=1e-12)


def test_thinned_points_give_the_same_rays():
    points, limits = labelled(CAMERA, standing(6))
    some = np.union1d(np.arange(0, len(points), 13), limits)
    thinned = depth_border_rays(points[some], np.searchsorted(some, limits), CAMERA)
    np.testing.assert_allclose(thinned, depth_border_rays(points, limits, CAMERA), atol=1e-12)


def rectangle(left: int, top: int, right: int, bottom: int) -> tuple[Array, IntArray]:
    """Points at 2 m of the pixels of a rectangle, and which are on its border."""
    v, u = (each.ravel() for each in np.mgrid[top : bottom + 1, left : right + 1])
    xy = CAMERA.normalise(np.stack([u, v], -1).astype(float))
    points = 2.0 * np.column_stack([xy, np.ones(len(xy))])
    return points, np.flatnonzero((u == left) | (u == right) | (v == top) | (v == bottom))


def test_a_border_along_rows_and_columns_is_rejected():
    """All its pixels err alike, by anything up to half a pixel."""
    points, limits = rectangle(100, 80, 200, 150)
    found = np.isfinite(depth_border_rays(points, limits, CAMERA)).all(-1)
    assert found.sum() <= 8  # those from which a corner looks like a step


def test_across_a_gap_there_is_no_direction():
    """If a border is truncated, as by the edge of the image, the ends of the rest are not on it."""
    points, limits = labelled(CAMERA, standing(2))
    pixels = CAMERA.project(points[limits])
    middle = pixels.mean(0)
    kept = limits[pixels[:, 1] < middle[1]]
    T = standing(2)
    rays = depth_border_rays(points, kept, CAMERA)
    found = np.isfinite(rays[:, 0])
    assert found.mean() > 0.5
    assert np.abs(outside(rays[found], T)).max() < 1.2 * 2.0 / 280


def test_few_limit_points_give_no_rays():
    points, limits = labelled(CAMERA, standing(3))
    assert np.isnan(depth_border_rays(points, limits[: 2 * PIXELS_ON_EITHER_SIDE], CAMERA)).all()
    assert depth_border_rays(points, limits[:0], CAMERA).shape == (0, 3)
