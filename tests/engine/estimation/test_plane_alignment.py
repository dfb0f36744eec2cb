"""Planes seen by a LiDAR: fitted, and aligned with where they are known to be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.estimation.start.linear_solvers import align_planes, align_scans, fit_planes, scan_equations
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, distance, inverse, retract, transform
from tests.engine.estimation.tangled import random_poses
from tests.properties import at_most


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


RAYS = 30


def scan_lines(n: int, seed: int = 0, noise: float = 0.0, solid: bool = False) -> tuple[Array, Array, Array, Array]:
    """Of n planes: points (30 n, 3), normals, offsets and the transform that puts points on planes.

    The points lie in the plane z = 0, or (solid) in one of any tilt for each view.
    """
    rng = np.random.default_rng(seed)
    T_planes_points = random_poses(rng)
    normals = rotations.exp(rng.uniform(-0.6, 0.6, (n, 3))) @ [1.0, 0.0, 0.0]  # in the points' frame
    offsets = rng.uniform(1.0, 2.5, n)
    azimuth = np.linspace(-0.3, 0.3, RAYS)
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], -1)
    rays = np.broadcast_to(rays, (n, RAYS, 3))
    if solid:
        rays = rays @ np.swapaxes(rotations.exp(rng.uniform(-0.4, 0.4, (n, 3)) * [1.0, 1.0, 0.0]), 1, 2)
    ranges = offsets[:, None] / np.einsum("nki,ni->nk", rays, normals) + rng.normal(size=(n, RAYS)) * noise
    points = (rays * ranges[..., None]).reshape(-1, 3)
    moved = normals @ T_planes_points[:3, :3].T
    d = offsets + moved @ T_planes_points[:3, 3]
    return points, np.repeat(moved, RAYS, axis=0), np.repeat(d, RAYS), T_planes_points


@at_most(40)
@given(seed=st.integers(0, 10_000), n=st.integers(6, 20), solid=st.booleans())
def test_exact_scan_lines_give_the_exact_transform(seed, n, solid):
    points, normals, offsets, T = scan_lines(n + 2 * solid, seed, solid=solid)
    np.testing.assert_allclose(align_scans(points, normals, offsets), T, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_sensor_upside_down_is_another_solution_and_not_taken_for_it(seed):
    points, normals, offsets, T = scan_lines(8, seed)
    turned = align_scans(points * [1.0, -1.0, 1.0], normals, offsets)  # about its x axis
    np.testing.assert_allclose(turned @ transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3)), T, atol=1e-7)


def test_the_sides_of_the_planes_do_not_matter():
    points, normals, offsets, T = scan_lines(8)
    sign = np.random.default_rng(0).choice([-1.0, 1.0], len(points))
    np.testing.assert_allclose(align_scans(points, normals * sign[:, None], offsets * sign), T, atol=1e-8)


@pytest.mark.parametrize("spoilt", ["points", "views"])
@pytest.mark.parametrize("seed", range(5))
def test_a_fifth_of_the_points_off_or_of_the_planes_wrong_do_little_harm(spoilt, seed):
    points, normals, offsets, T = scan_lines(20, seed, noise=0.01)
    rng = np.random.default_rng(seed)
    if spoilt == "points":
        off = rng.random(len(points)) < 0.2
        points[off] *= rng.uniform(0.6, 1.6, (off.sum(), 1))
    else:
        for view in rng.permutation(20)[:4]:
            part = slice(view * RAYS, (view + 1) * RAYS)
            normals[part] = normals[part] @ rotations.exp(rng.normal(size=3) * 0.5)
            offsets[part] += rng.uniform(-0.3, 0.3)
    translation, rotation = distance(align_scans(points, normals, offsets), T)
    assert translation < 0.08
    assert rotation < 0.04


def test_noise_moves_the_result_as_little_as_the_best_fit_does():
    """Refined: nothing near it has a smaller sum of absolute distances."""
    points, normals, offsets, _ = scan_lines(10, 3, noise=0.01)
    found = align_scans(points, normals, offsets)
    rng = np.random.default_rng(0)

    def miss(T: Array) -> float:
        return float(np.abs((normals * apply(T, points)).sum(-1) - offsets).mean())

    nearby = [
        found @ transform(rotations.exp(rng.normal(size=3) * 0.003), rng.normal(size=3) * 0.005) for _ in range(50)
    ]
    assert miss(found) < 0.0085  # 0.01 sqrt(2 / pi), and what a ray meets obliquely errs less across the plane
    assert all(miss(T) > miss(found) - 1e-4 for T in nearby)


@pytest.mark.parametrize("n", [1, 3, 4])
def test_fewer_than_five_planes_are_too_few(n):
    points, normals, offsets, _ = scan_lines(n)
    assert align_scans(points, normals, offsets) is None


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("alike", ["all parallel", "tilted about one axis"])
def test_planes_that_are_too_much_alike_give_nothing(alike, noise):
    rng = np.random.default_rng(1)
    normals = np.array([[np.cos(a), np.sin(a), 0.2] for a in ([0.3] * 12 if alike == "all parallel" else range(12))])
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    if alike == "tilted about one axis":
        normals = (rotations.exp(np.linspace(-0.6, 0.6, 12)[:, None] * [0.0, 0.0, 1.0])) @ [1.0, 0.0, 0.0]
    azimuth = np.linspace(-0.3, 0.3, RAYS)
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], -1)
    offsets = rng.uniform(1, 2, 12)
    ranges = offsets[:, None] / (normals @ rays.T) + noise * rng.normal(size=(12, RAYS))
    points = (rays * ranges[..., None]).reshape(-1, 3)
    wobbly = normals + 0.2 * noise * rng.normal(size=normals.shape)  # the planes are not known exactly either
    assert align_scans(points, np.repeat(wobbly, RAYS, axis=0), np.repeat(offsets, RAYS)) is None


def test_too_few_points_give_nothing():
    points, normals, offsets, _ = scan_lines(8)
    assert align_scans(points[:8], normals[:8], offsets[:8]) is None


def test_the_equations_are_those_of_the_chain():
    rng = np.random.default_rng(2)
    before, after, X = random_poses(rng, 50), random_poses(rng, 50), random_poses(rng)
    flat = np.append(rng.normal(size=(50, 2)), np.zeros((50, 1)), -1)
    T = before @ X @ after
    points, normals, offsets = scan_equations(np.einsum("nij,nj->ni", T[:, :3, :3], flat) + T[:, :3, 3], before, after)
    np.testing.assert_allclose((normals * apply(inverse(X), points)).sum(-1), offsets, atol=1e-12)
