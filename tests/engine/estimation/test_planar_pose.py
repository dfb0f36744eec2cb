"""Planar poses: exact views, partial and degenerate ones, flips, robust means."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.dataset.pattern import grid
from calibration.engine.estimation.residuals.planar_pose import determines_pose, mean_pose, mirrored_poses, planar_poses
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, distance, inverse, retract, transform, translation

CORNERS = grid(10, 5, 0.06, (0.06, 0.06))
CENTRE = CORNERS.mean(0)
FOCAL = 800.0


def views(seed: int, n: int, tilt: float = 0.4, depth: float = 1.5) -> Array:
    """Poses of patterns about `depth` m away, tilted by about `tilt` rad a coordinate."""
    rng = np.random.default_rng(seed)
    R = rotations.exp(rng.normal(size=(n, 3)) * tilt)
    t = rng.uniform([-0.4, -0.3, 0.75], [0.4, 0.3, 1.25], (n, 3)) * [1, 1, depth]
    return transform(R, t - R @ CENTRE)


def rays_of(T: Array, noise: float = 0.0, seed: int = 0) -> Array:
    """Rays of a camera's view (V, 2, K), with noise in pixels."""
    p = apply(T, CORNERS)
    exact = (p[..., :2] / p[..., 2:]).swapaxes(1, 2)
    return exact + np.random.default_rng(seed).normal(size=exact.shape) * noise / FOCAL


def only(indices: list[int], n: int) -> np.ndarray:
    seen = np.zeros((n, len(CORNERS)), bool)
    seen[:, indices] = True
    return seen


@given(seed=st.integers(0, 2**32 - 1), tilt=st.floats(0, 0.5), depth=st.floats(1, 100))
def test_exact_views_give_exact_poses(seed, tilt, depth):
    T = views(seed, 5, tilt, depth)
    found = planar_poses(rays_of(T), CORNERS)
    np.testing.assert_allclose(found[:, :3, :3], T[:, :3, :3], atol=1e-9 * depth)
    np.testing.assert_allclose(found[:, :3, 3], T[:, :3, 3], atol=1e-9 * depth**2)


def test_every_pose_is_a_rigid_motion_with_the_pattern_in_front():
    rays = rays_of(views(1, 200, tilt=1.0), noise=20.0)
    T = planar_poses(rays, CORNERS)
    np.testing.assert_allclose(T[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2), np.eye(3) + np.zeros((200, 3, 3)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1)
    assert (apply(T, CENTRE[None])[:, 0, 2] > 0).all()


def test_all_seen_is_the_same_as_no_mask():
    rays = rays_of(views(2, 300), noise=0.3)
    np.testing.assert_allclose(planar_poses(rays, CORNERS), planar_poses(rays, CORNERS, np.ones((300, 50), bool)))


def test_a_view_does_not_depend_on_its_neighbours():
    rays, seen = rays_of(views(3, 300), noise=0.3), np.random.default_rng(3).random((300, 50)) < 0.5
    together, alone = planar_poses(rays, CORNERS, seen), planar_poses(rays[200:201], CORNERS, seen[200:201])
    np.testing.assert_allclose(together[200:201], alone)


def test_the_unseen_corners_do_not_matter():
    T, seen = views(4, 100), np.random.default_rng(4).random((100, 50)) < 0.4
    rays = np.where(seen[:, None], rays_of(T), np.nan)
    np.testing.assert_allclose(planar_poses(rays, CORNERS, seen), T, atol=1e-9)


@pytest.mark.parametrize(
    ("indices", "possible"),
    [
        ([], False),
        ([0, 1, 10], False),
        (list(range(10)), False),
        ([*range(10), 25], False),
        ([0, 11, 22, 33, 44, 5], False),
        ([0, 1, 10, 11], True),
        ([0, 1, 2, 10, 20], True),
        ([*range(10), 25, 26], True),
        (list(range(20)), True),
    ],
    ids=["none", "three", "a row", "a row and one", "a diagonal and one", "a square", "an L", "a row and two", "rows"],
)
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_views_that_cannot_give_a_pose_are_nan(indices, possible, noise):
    found = planar_poses(rays_of(views(5, 30), noise), CORNERS, only(indices, 30))
    assert (np.isfinite(found).all((1, 2)) == possible).all()


@pytest.mark.parametrize("rays", [np.zeros((2, 50)), np.stack([CORNERS[:, 0], 0.5 * CORNERS[:, 0] + 0.1])])
def test_an_image_that_is_a_point_or_a_line_is_nan(rays):
    assert np.isnan(planar_poses(rays[None], CORNERS)).all()


def test_a_label_that_is_not_finite_is_nan_and_stays_in_its_view():
    T = views(6, 3)
    rays = rays_of(T)
    rays[1, 0, 7] = np.inf
    found = planar_poses(rays, CORNERS)
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(found[[0, 2]], T[[0, 2]], atol=1e-9)


def test_no_view_at_all():
    assert planar_poses(np.empty((0, 2, 50)), CORNERS).shape == (0, 4, 4)


def mirrored(T):
    centre = translation(CENTRE)
    return mirrored_poses(T @ centre) @ inverse(centre)


def test_a_mirrored_pose_looks_the_same_from_afar():
    T = views(14, 50, depth=100.0)
    M = mirrored(T)
    assert np.median(distance(T, M)[1]) > 0.5
    size = 0.3 * FOCAL / 100  # of the pattern in the image, px
    assert (np.abs(rays_of(M) - rays_of(T)) * FOCAL).max() < 0.02 * size


def test_a_mirrored_pose_is_a_rigid_motion_and_mirrors_back():
    T = views(15, 50)
    M = mirrored(T)
    np.testing.assert_allclose(np.linalg.det(M[:, :3, :3]), 1)
    np.testing.assert_allclose(apply(M, CENTRE[None]), apply(T, CENTRE[None]))
    np.testing.assert_allclose(mirrored(M), T, atol=1e-12)
    # the normal is turned by pi about the line of sight
    v = apply(T, CENTRE[None])[:, 0]
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    n = T[:, :3, 2]
    np.testing.assert_allclose(M[:, :3, 2], 2 * (n * v).sum(1, keepdims=True) * v - n, atol=1e-12)


def test_the_mean_of_equal_poses_is_that_pose():
    T = views(17, 1)
    np.testing.assert_allclose(mean_pose(np.repeat(T, 4, 0)), T[0], atol=1e-12)
    np.testing.assert_allclose(mean_pose(T), T[0], atol=1e-12)


def test_the_mean_hardly_feels_outliers():
    rng = np.random.default_rng(18)
    T = views(18, 1)[0]
    poses = retract(np.repeat(T[None], 30, 0), rng.normal(size=(30, 6)) * 1e-3)
    poses[:10] = views(19, 10, tilt=2.0)
    moved, angle = distance(T, mean_pose(poses))
    assert moved < 1.5e-3
    assert angle < 1.5e-3


def test_the_mean_turns_with_the_frame():
    rng = np.random.default_rng(20)
    poses = retract(np.repeat(views(20, 1), 9, 0), rng.normal(size=(9, 6)) * 0.1)
    G = views(21, 1)[0]
    np.testing.assert_allclose(mean_pose(G @ poses)[:3, :3], (G @ mean_pose(poses))[:3, :3], atol=1e-7)
    np.testing.assert_allclose(mean_pose(poses @ G)[:3, :3], (mean_pose(poses) @ G)[:3, :3], atol=1e-7)


def test_the_mean_of_positions_is_their_median():
    poses = transform(np.eye(3), np.array([[0.0, 0, 0], [1, 1, 1], [5, 6, 7], [2, 2, 2]]))
    np.testing.assert_allclose(mean_pose(poses)[:3, 3], np.median(poses[:, :3, 3], 0))
    np.testing.assert_allclose(mean_pose(poses[:3])[:3, 3], np.median(poses[:3, :3, 3], 0))


def test_the_mean_of_no_poses_is_an_error():
    with pytest.raises(ValueError, match="no poses"):
        mean_pose(np.empty((0, 4, 4)))


def test_an_input_is_not_changed():
    T, seen = views(22, 4), np.ones((4, 50), bool)
    rays = rays_of(T)
    before = T.copy(), rays.copy()
    planar_poses(rays, CORNERS, seen)
    mirrored(T)
    mean_pose(inverse(T))
    np.testing.assert_array_equal(T, before[0])
    np.testing.assert_array_equal(rays, before[1])


def test_no_three_corners_determine_a_pose() -> None:
    """What they leave of the squared errors is rounding, of any shape."""
    random = np.random.default_rng(0)
    seen = random.permuted(np.arange(len(CORNERS)) < np.full((100, 1), 3), axis=1)
    assert set(seen.sum(1)) == {3}
    assert not determines_pose(CORNERS, seen).any()
    assert np.isnan(planar_poses(random.normal(size=(100, 2, len(CORNERS))), CORNERS, seen)).all()
