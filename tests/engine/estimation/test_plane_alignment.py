"""Planes seen by a LiDAR: fitted, and aligned with where they are known to be."""

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.estimation.start.plane_alignment import align_planes, fit_planes
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, distance, inverse, retract, transform
from tests.engine.estimation.tangled import random_poses


def measured(n: int, seed: int = 0, behind: bool = False) -> tuple[Array, Array, Array, Array, Array]:
    """Normals (n, 3), distances (n,), before and after (n, 4, 4), X (4, 4): exactly consistent."""
    rng = np.random.default_rng(seed)
    ahead = np.array([0.0, 0.0, 1.5])
    R = rotations.exp(rng.normal(size=(n, 3)) * 0.4)
    T_sensor_pattern = transform(R, ahead + rng.uniform(-0.3, 0.3, (n, 3)))
    if behind:
        T_sensor_pattern = T_sensor_pattern @ transform(rotations.exp([np.pi, 0, 0]), np.zeros(3))
    normals = T_sensor_pattern[:, :3, 2]
    offsets = (normals * T_sensor_pattern[:, :3, 3]).sum(-1)
    away = np.sign(offsets)
    X, before = random_poses(rng), random_poses(rng, n)
    return normals * away[:, None], offsets * away, before, inverse(X) @ inverse(before) @ T_sensor_pattern, X


def test_planes_are_fitted_exactly_and_point_away():
    rng = np.random.default_rng(0)
    T = transform(rotations.exp(rng.normal(size=(40, 3)) * 2), rng.normal(size=(40, 3)))
    flat = np.concatenate([rng.uniform(-0.3, 0.3, (40, 25, 2)), np.zeros((40, 25, 1))], -1)
    present = rng.random((40, 25)) < 0.7
    points = np.where(present[..., None], apply(T, flat), 99.0).swapaxes(1, 2)
    normals, offsets = fit_planes(points, present)
    expected = (T[:, :3, 2] * T[:, :3, 3]).sum(-1)
    np.testing.assert_allclose(offsets, np.abs(expected), atol=1e-9)
    np.testing.assert_allclose(normals, T[:, :3, 2] * np.sign(expected)[:, None], atol=1e-9)


@pytest.mark.parametrize("n", [3, 4, 20])
@pytest.mark.parametrize("seed", range(3))
def test_exact_planes_give_the_exact_transform_from_any_guess(n, seed):
    normals, offsets, before, after, X = measured(n, seed)
    guess = random_poses(np.random.default_rng(seed + 100))
    found, by_guess = align_planes(normals, offsets, before, after, guess)
    np.testing.assert_allclose(found, X, atol=1e-7)
    assert not by_guess


@pytest.mark.parametrize("seed", range(10))
def test_the_other_side_of_the_pattern_is_resolved_by_the_guess(seed):
    normals, offsets, before, after, X = measured(12, seed, behind=True)
    guess = retract(X, np.random.default_rng(seed).choice([-0.4, 0.4], 6))
    found, by_guess = align_planes(normals, offsets, before, after, guess)
    np.testing.assert_allclose(found, X, atol=1e-7)
    assert by_guess


def test_single_wrong_views_do_not_count():
    normals, offsets, before, after, X = measured(20, 3)
    normals[[4, 9]] = normals[[4, 9]] @ rotations.exp([0.0, 0.8, 0.0])
    offsets[[4, 9, 15]] += 0.3
    found, _ = align_planes(normals, offsets, before, after, X)
    translation, rotation = distance(found, X)
    assert translation < 0.02
    assert rotation < 0.02


def test_noise_on_the_planes_moves_the_result_as_much():
    normals, offsets, before, after, X = measured(30, 4)
    rng = np.random.default_rng(0)
    normals += 0.005 * rng.normal(size=normals.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    found, _ = align_planes(normals, offsets + 0.003 * rng.normal(size=30), before, after, X)
    translation, rotation = distance(found, X)
    assert translation < 0.02
    assert rotation < 0.01


@pytest.mark.parametrize("tilt", [0.0, 1e-4])
def test_translations_that_parallel_planes_leave_open_are_those_of_the_guess(tilt):
    """Planes that are parallel up to their noise do not determine the other two directions."""
    rng = np.random.default_rng(0)
    turned = transform(rotations.exp(np.linspace(-1, 1, 6)[:, None] * [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    normals = turned[:, :3, 2] + tilt * rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    guess = transform(np.eye(3), [0.4, -0.2, 0.3])
    offsets = 1.0 + 10 * tilt * rng.normal(size=6)
    found, by_guess = align_planes(normals, offsets, np.broadcast_to(np.eye(4), (6, 4, 4)), turned, guess)
    assert by_guess
    np.testing.assert_allclose(found[:3, 3], [0.4, -0.2, 0.0], atol=1e-9 + 20 * tilt)
    np.testing.assert_allclose(found[:3, 2], [0.0, 0.0, 1.0], atol=1e-9 + 2 * tilt)


def test_the_guess_has_no_effect_where_the_planes_determine_all():
    normals, offsets, before, after, X = measured(12, 5)
    offsets += 0.003 * np.random.default_rng(0).normal(size=12)
    guesses = (retract(X, np.random.default_rng(seed).uniform(-0.2, 0.2, 6)) for seed in range(4))
    found = [align_planes(normals, offsets, before, after, guess) for guess in guesses]
    assert len({T.tobytes() for T, _ in found}) == 1
    assert not any(by_guess for _, by_guess in found)


def test_a_translation_along_the_common_line_of_all_planes_is_that_of_the_guess():
    turned = transform(rotations.exp(np.linspace(-1, 1, 6)[:, None] * [1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    normals = turned[:, :3, 2]
    guess = transform(np.eye(3), [0.4, -0.2, 0.3])
    here = np.broadcast_to(np.eye(4), (6, 4, 4))
    found, by_guess = align_planes(normals, normals[:, 2], here, turned, guess)
    assert by_guess
    np.testing.assert_allclose(found[:3, 3], [0.4, 0.0, 0.0], atol=1e-9)
