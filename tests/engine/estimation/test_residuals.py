"""Residual terms: their gradient and Hessian against differences, views against each other, what cannot be seen."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.estimation.problem.problem import Term
from calibration.engine.estimation.residuals import views
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import BorderTerm, RangeTerm
from calibration.engine.estimation.residuals.views import product, robust, sum_of_products, total_loss
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, retract, transform
from tests.engine.estimation.scenes import PINHOLE, WIDE, board, looks

PATTERN = board()
CORNERS = PATTERN.corners - PATTERN.centre
NORMALS, OFFSETS = np.array([[0.0, -1], [1, 0], [0, 1], [-1, 0]]), np.array([0.15, 0.18, 0.15, 0.18])
V = 5


def poses(n: int = V) -> Array:
    """Of the pattern's centre."""
    T = looks(n, seed=1)
    T[:, :3, 3] = apply(T, PATTERN.centre[None])[:, 0]
    return T


def corners(camera: Camera, error: float, partial: bool = False) -> CornerTerm:
    rng = np.random.default_rng(1)
    pixels = camera.project(apply(poses(), CORNERS)).swapaxes(1, 2)
    seen = rng.random((V, len(CORNERS))) < 0.6 if partial else None
    return CornerTerm(camera, CORNERS, pixels + rng.normal(size=pixels.shape) * error, seen)


def rays_to(points: Array) -> tuple[Array, Array]:
    """Lengths (V, L) and directions (V, 3, L) of points (V, L, 3)."""
    lengths = np.linalg.norm(points, axis=-1)
    return lengths, (points / lengths[..., None]).swapaxes(1, 2)


def ranges(error: float) -> RangeTerm:
    rng = np.random.default_rng(2)
    on_plane = np.concatenate([rng.uniform(-0.15, 0.15, (V, 20, 2)), np.zeros((V, 20, 1))], -1)
    lengths, rays = rays_to(apply(poses(), on_plane))
    return RangeTerm(rays, lengths + rng.normal(size=lengths.shape) * error, rng.random((V, 20)) < 0.8)


def border(error: float) -> BorderTerm:
    rng = np.random.default_rng(3)
    along, side = rng.uniform(-0.7, 0.7, (V, 24)), np.arange(24) % 4
    x = np.where(side % 2 == 1, np.sign(side - 2) * -0.18, along * 0.18)
    y = np.where(side % 2 == 0, np.sign(side - 1) * 0.15, along * 0.15)
    at_border = np.stack([x, y, 0 * x], -1) + rng.normal(size=(V, 24, 3)) * [error, error, 0]
    lengths, rays = rays_to(apply(poses(), at_border))
    return BorderTerm(
        rays, lengths + rng.normal(size=lengths.shape) * error, rng.random((V, 24)) < 0.8, NORMALS, OFFSETS
    )


def measured(kind: Literal["pose_translation", "pose_rotation"], error: float) -> PoseTerm:
    errors = np.random.default_rng(24).normal(size=(V, 6)) * error
    return PoseTerm(retract(poses(), errors), kind)


TERMS: dict[str, tuple[Callable[[float], Term], float]] = {
    "corners": (lambda e: corners(PINHOLE, e), 0.5),
    "distorted corners": (lambda e: corners(WIDE, e), 0.5),
    "partial views": (lambda e: corners(WIDE, e, partial=True), 0.5),
    "ranges": (ranges, 0.01),
    "border": (border, 0.005),
    "measured translation": (lambda e: measured("pose_translation", e), 0.002),
    "measured rotation": (lambda e: measured("pose_rotation", e), 0.02),
}
EVERY_TERM = pytest.mark.parametrize("name", TERMS)


def moved(T: Array, twist: Array) -> Array:
    """Motions in the patterns' frames."""
    return retract(T, twist)


def cost(term: Term, T: Array, scale: float, huber: float | None) -> Array:
    return term.linearise(T, scale, huber)[0]


@EVERY_TERM
@pytest.mark.parametrize("huber", [None, 0.8])
def test_the_gradient_is_half_that_of_the_cost(name, huber):
    make, sigma = TERMS[name]
    term, T = make(sigma), poses()
    _, _, g = term.linearise(T, sigma, huber)
    for k, axis in enumerate(np.eye(6)):
        h = 1e-6
        slope = (cost(term, moved(T, h * axis), sigma, huber) - cost(term, moved(T, -h * axis), sigma, huber)) / (2 * h)
        np.testing.assert_allclose(2 * g[:, k], slope, rtol=1e-4, atol=1e-5 * np.abs(g).max())


@EVERY_TERM
def test_without_residuals_the_hessian_is_that_of_the_cost(name):
    make, sigma = TERMS[name]
    term, T = make(0.0), poses()
    zero, H, g = term.linearise(T, sigma, None)
    np.testing.assert_allclose(zero, 0, atol=1e-18)
    np.testing.assert_allclose(g, 0, atol=1e-6)
    h = 1e-6
    for k, axis in enumerate(np.eye(6)):
        ahead = term.linearise(moved(T, h * axis), sigma, None)[2]
        behind = term.linearise(moved(T, -h * axis), sigma, None)[2]
        np.testing.assert_allclose(H[:, k], (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-6 * np.abs(H).max())


@EVERY_TERM
def test_a_view_does_not_depend_on_its_neighbours(name, monkeypatch):
    make, sigma = TERMS[name]
    term = make(sigma)
    T = moved(poses(), np.full((V, 6), 0.001))
    together = term.linearise(T, sigma, 1.5)
    for v in range(V):
        alone = term.take(slice(v, v + 1)).linearise(T[v : v + 1], sigma, 1.5)
        for all_views, view in zip(together, alone, strict=True):
            np.testing.assert_allclose(all_views[v : v + 1], view, rtol=1e-12)
    magnitudes = term.magnitudes(T)
    monkeypatch.setattr(views, "LABELS_PER_CHUNK", 2)
    for whole, chunked in zip(together, term.linearise(T, sigma, 1.5), strict=True):
        np.testing.assert_allclose(chunked, whole, rtol=1e-12)
    np.testing.assert_array_equal(term.magnitudes(T), magnitudes)


@EVERY_TERM
def test_what_was_found_stays_when_more_is_asked_for(name):
    """The rows are overwritten each time, results are not."""
    make, scale = TERMS[name]
    term = make(scale)
    found = term.linearise(poses(), scale, 0.8)
    kept = [each.copy() for each in found]
    term.linearise(moved(poses(), np.full(6, 0.01)), scale, 0.8)
    for now, then in zip(found, kept, strict=True):
        np.testing.assert_array_equal(now, then)


@EVERY_TERM
def test_the_cost_is_the_sum_of_squared_magnitudes(name):
    make, sigma = TERMS[name]
    term = make(sigma)
    magnitudes = term.magnitudes(poses())
    np.testing.assert_array_equal(np.isfinite(magnitudes).sum(-1), term.counts)
    np.testing.assert_allclose(cost(term, poses(), sigma, None), np.nansum((magnitudes / sigma) ** 2, -1))
    errors = magnitudes * term.ranges if name == "border" else magnitudes  # an angle is a distance over the range
    assert np.nanmean(errors**2) == pytest.approx(term.dimension * sigma**2, rel=0.35)


@EVERY_TERM
def test_the_squares_are_those_of_the_magnitudes(name):
    make, sigma = TERMS[name]
    term = make(sigma)
    squares = np.full((V, term.length), 7.0)
    term.linearise(poses(), sigma, 0.8, squares)
    np.testing.assert_allclose(squares, term.magnitudes(poses()) ** 2, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("huber", [None, 0.8])
@pytest.mark.parametrize("labels", [2, 10**6])
def test_views_with_few_points_do_not_cut_those_with_many(huber, labels, monkeypatch):
    """Views are evaluated in the order of their last points, in one chunk or in several."""
    monkeypatch.setattr(views, "LABELS_PER_CHUNK", labels)
    term, T = ranges(0.01), poses()
    present = np.arange(20) < np.array([20, 3, 11, 7, 1])[:, None]
    term = replace(term, present=present)
    magnitudes = term.magnitudes(T)
    loss = [robust((m[p][None] / 0.01) ** 2, huber)[0].sum() for m, p in zip(magnitudes, present, strict=True)]
    squares = np.full(present.shape, 7.0)
    np.testing.assert_allclose(term.linearise(T, 0.01, huber, squares)[0], loss, rtol=1e-12)
    np.testing.assert_allclose(squares, magnitudes**2, rtol=1e-9)


@pytest.mark.parametrize("name", ["partial views", "ranges", "border"])
def test_what_is_not_there_does_not_matter(name):
    make, sigma = TERMS[name]
    term, T = make(sigma), poses()
    before = term.linearise(T, sigma, 1.0)
    if isinstance(term, CornerTerm):
        term = replace(term, pixels=np.where(term.seen[:, None], term.pixels, np.nan))
    else:
        term.rays[...] = np.where(term.present[:, None], term.rays, 0.6)
        term.ranges[...] = np.where(term.present, term.ranges, 7.0)
    for a, b in zip(before, term.linearise(T, sigma, 1.0), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_corner_behind_the_camera_costs_infinity_in_its_view_alone():
    term, T = corners(WIDE, 0.5), poses()
    T[2, :3, 3] *= -1
    infinite = np.isinf(cost(term, T, 0.5, 2.5))
    assert infinite.tolist() == [False, False, True, False, False]
    magnitudes = term.magnitudes(T)
    assert np.isnan(magnitudes[2]).all()
    assert np.isfinite(magnitudes[[0, 1, 3, 4]]).all()


def test_an_unseen_corner_behind_the_camera_costs_nothing():
    T = transform(rotations.exp([0.0, 1.4, 0.0]), [[0.0, 0.0, 0.1]])  # the right half lies behind
    depth = apply(T, CORNERS)[0, :, 2]
    term = CornerTerm(PINHOLE, CORNERS, np.zeros((1, 2, len(CORNERS))), (depth > 0.01)[None])
    assert 0 < term.counts[0] < len(CORNERS)
    assert np.isfinite(cost(term, T, 1.0, None)).all()


@pytest.mark.parametrize("make", [ranges, border])
@pytest.mark.parametrize("huber", [None, 0.8])
def test_a_lidar_has_a_finite_cost_and_its_gradient_wherever_the_plane_is(make, huber):
    term, T = make(0.001), poses()
    T[0, :3, 3] *= -1
    T[1, :3, :3] = rotations.exp([0.0, np.pi / 2, 0.0])  # seen from its edge
    T[2, :3, :3] = rotations.exp([0.0, np.pi / 2 - 0.03, 0.0])
    T[3] = np.eye(4)
    value, _, g = term.linearise(T, 0.01, huber)
    assert np.isfinite(value).all()
    assert make is border or (value[:4] > 100).all()
    h = 1e-7
    for k, axis in enumerate(np.eye(6)):
        slope = (cost(term, moved(T, h * axis), 0.01, huber) - cost(term, moved(T, -h * axis), 0.01, huber)) / (2 * h)
        np.testing.assert_allclose(2 * g[:, k], slope, rtol=1e-4, atol=1e-5 * np.abs(g).max())


def test_the_range_residual_is_taken_along_the_ray():
    T = transform(rotations.exp([0.0, 1.0, 0.0]), [[0.0, 0.0, 2.0]])
    term = RangeTerm(np.array([[[0.0], [0.0], [1.0]]]), np.array([[2.3]]), np.ones((1, 1), bool))
    assert term.magnitudes(T)[0, 0] == pytest.approx(0.3, rel=0.005)
    assert cost(term, T, 0.1, None)[0] == pytest.approx(9, rel=0.01)


def test_the_border_residual_is_the_distance_to_the_nearest_line_over_the_range():
    T = transform(np.eye(3), [[0.0, 0.0, 1.0]])
    at = np.array([[0.2, 0.0, 1.0], [-0.17, 0.02, 1.0], [0.03, 0.11, 1.0], [0.0, -0.151, 1.0]])[None]
    lengths, rays = rays_to(at)
    for error in (0.0, 0.02):  # the range hardly matters
        term = BorderTerm(rays, lengths + error, np.ones((1, 4), bool), NORMALS, OFFSETS)
        distances = term.magnitudes(T) * (lengths + error)
        np.testing.assert_allclose(distances[0], [0.02, 0.01, 0.04, 0.001], atol=1e-12 + 6e-4 * error)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=20), st.floats(0.1, 10))
def test_hubers_loss_is_smooth_and_grows_linearly(squared, k):
    e2 = np.array([squared])
    loss, weight = robust(e2, k)
    e = np.sqrt(e2[0])
    np.testing.assert_allclose(loss[0], np.where(e <= k, e2[0], 2 * k * e - k * k).sum())
    assert loss[0] <= e2.sum() * (1 + 1e-12)
    w = np.ones_like(e) if weight is None else weight[0] ** 2
    np.testing.assert_allclose(w, np.minimum(1, k / np.maximum(e, 1e-300)))  # weight * e = half the slope


@pytest.mark.parametrize("huber", [None, 1.3])
def test_the_total_loss_is_that_of_all_labels_there_are(huber):
    errors = np.random.default_rng(5).normal(size=(7, 9)) * 0.4
    expected, _ = robust((errors / 0.2) ** 2, huber)
    assert total_loss(errors**2, 0.2, huber) == pytest.approx(expected.sum(), rel=1e-12)
    missing = np.concatenate([errors**2, np.full((7, 2), np.nan)], 1)
    assert total_loss(missing, 0.2, huber) == pytest.approx(expected.sum(), rel=1e-12)


@pytest.mark.parametrize("most", [1, 40, 1 << 18])
@pytest.mark.parametrize("rows", [0, 1, 37])
def test_products_in_pieces_are_those_of_the_whole(monkeypatch, most, rows):
    monkeypatch.setattr(views, "MAX_MULTIPLICATIONS", most)
    rng = np.random.default_rng([most, rows])  # others than those before, which may still lie in the memory
    A, B, small = rng.normal(size=(rows, 4)), rng.normal(size=(rows, 3)), rng.normal(size=(4, 3))
    np.testing.assert_allclose(product(A, small), A @ small, atol=1e-14)
    np.testing.assert_allclose(sum_of_products(A, B), A.T @ B, atol=1e-13)
    np.testing.assert_array_equal(sum_of_products(A[:, :0], B), np.zeros((0, 3)))
