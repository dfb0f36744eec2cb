"""What holds for every lens: what it projects comes back, over all that it sees, and its derivatives are right."""

from typing import get_args

import numpy as np
import pytest

from calibration.engine.estimation.options import LensModel
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import (
    MODELS,
    SYNONYMS,
    DoubleSphere,
    Equidistant,
    Eucm,
    Omni,
    PlumbBob,
    Rational,
)
from calibration.engine.geometry.transforms import apply, transform

WIDEST = [  # half of the field of view, deg
    (Equidistant(-0.02, 0.01, -0.003, 0.0005), 97.5),
    (DoubleSphere(-0.2, 0.59), 105),
    (DoubleSphere(0.3, 0.65), 105),
    (Eucm(0.6, 1.1), 100),
    (Eucm(0.65, 0.9), 100),
    (Omni(1.5, -0.05, 0.005, 0.001, -0.002), 100),
    (Omni(0.9), 110),
    (PlumbBob(-0.2, 0.05, 0.001, -0.001), 35),
    (Rational(0.5, 0.1, 0.001, -0.002, 0.02, 0.8, 0.3, 0.05), 40),
]


def test_every_model_is_tested():
    assert {type(lens) for lens, _ in WIDEST} == set(MODELS.values())


def camera_of(lens):
    return Camera(300.0, 310.0, 640.0, 480.0, 1280, 960, lens)


def rays(degrees, seed=0, count=400):
    random = np.random.default_rng(seed)
    angle = np.radians(degrees) * np.concatenate([np.sqrt(random.random(count)), [0, 1e-9, 1e-4, 0.03, 0.1]])
    around = 2 * np.pi * random.random(len(angle))
    return np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], -1)


@pytest.mark.parametrize(("lens", "degrees"), WIDEST, ids=str)
def test_what_is_projected_comes_back(lens, degrees):
    camera, directions = camera_of(lens), rays(degrees)
    pixels, visible = camera.project_visible(3 * directions)
    assert visible.all()
    back = camera.rays(pixels)
    np.testing.assert_allclose(back / np.linalg.norm(back, axis=-1, keepdims=True), directions, atol=1e-11)


@pytest.mark.parametrize(("lens", "degrees"), WIDEST, ids=str)
def test_the_derivatives_by_the_point_are_the_numerical_ones(lens, degrees):
    camera, points = camera_of(lens), 2 * rays(degrees)
    h = 1e-6
    by_point = [(camera.project(points + h * e) - camera.project(points - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(camera.slopes(points.T), np.moveaxis(by_point, (0, 2), (1, 0)), atol=2e-5)


@pytest.mark.parametrize(("lens", "degrees"), WIDEST, ids=str)
def test_a_pattern_at_the_side_has_its_pose_and_its_derivatives(lens, degrees):
    x, y = np.meshgrid(np.arange(6) * 0.1 - 0.25, np.arange(5) * 0.1 - 0.2)
    corners = np.stack([x.ravel(), y.ravel(), np.zeros(30)], -1)
    side = np.radians(degrees) - 0.32
    R = rotations.exp(np.array([[0.0, side, 0.0]])) @ rotations.exp(np.array([[0.3, -0.4, 0.2]]))
    T = transform(R, np.array([[np.sin(side), 0.0, np.cos(side)]]))
    camera = camera_of(lens)
    pixels, visible = camera.project_visible(apply(T, corners))
    assert visible.all()
    exact = CornerTerm(camera, corners, pixels.swapaxes(1, 2), None)
    np.testing.assert_allclose(exact.linear_poses, T, atol=1e-6)
    assert exact.magnitudes(T).max() < 1e-9

    noisy = CornerTerm(camera, corners, pixels.swapaxes(1, 2) + np.random.default_rng(1).normal(0, 1, (2, 30)), None)
    rows, _ = noisy.seen_with(camera, range(len(camera.parameters))).rows(T, slice(None), 1.0, None)
    J = rows[:, 0].reshape(len(rows), -1)
    for free in ((), tuple(range(len(camera.parameters)))):
        cost, H, g = noisy.seen_with(camera, free).linearise(T, 1.0, None)
        n = 6 + len(free)
        np.testing.assert_allclose(H[0], J[:n] @ J[:n].T, rtol=1e-9, atol=1e-9 * np.abs(H).max())
        np.testing.assert_allclose(g[0], J[:n] @ J[-1], rtol=1e-7, atol=1e-9 * np.abs(g).max())
        assert cost[0] == pytest.approx((J[-1] ** 2).sum())
    h = 1e-6
    for k in range(3):
        above, below = T.copy(), T.copy()
        above[0, :3, 3] += h * T[0, :3, k]
        below[0, :3, 3] -= h * T[0, :3, k]
        slope = (camera.project(apply(above, corners)) - camera.project(apply(below, corners)))[0] / (2 * h)
        np.testing.assert_allclose(J[k].reshape(2, 30), slope.T, atol=1e-4)


@pytest.mark.parametrize("lens", [each for each, _ in WIDEST if each.chart.radius(1.0) == 1.0], ids=str)
def test_what_a_lens_does_not_see_has_no_pixel_and_no_finite_cost(lens):
    camera = camera_of(lens)
    _, visible = camera.project_visible(np.array([[1e-3, 0.0, -1.0], [0.0, 0.0, -1.0], [0.1, 0.0, 1.0]]))
    assert visible.tolist() == [False, False, True]
    term = CornerTerm(camera, np.zeros((1, 3)), np.zeros((1, 2, 1)), None)
    cost, H, g = term.linearise(transform(np.eye(3), np.array([0.0, 0.0, -1.0]))[None], 1.0, None)
    assert np.isinf(cost).all()
    assert np.isfinite(H).all()
    assert np.isfinite(g).all()


def test_without_its_parameters_a_sphere_is_a_pinhole():
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 3], (50, 3))
    for model in (DoubleSphere, Eucm, Omni):
        np.testing.assert_allclose(camera_of(model()).project(points), camera_of(PlumbBob()).project(points))


def test_the_unified_model_is_a_special_case_of_the_others():
    points, xi = rays(80) * 2, 0.6
    expected = camera_of(Omni(xi)).project(points)
    np.testing.assert_allclose(camera_of(DoubleSphere(xi, 0.0)).project(points), expected)
    # (1 - alpha) / alpha is 1 / xi, and the image is larger by 1 - alpha = 1 / (1 + xi)
    camera = Camera(300.0 / (1 + xi), 310.0 / (1 + xi), 640.0, 480.0, 1280, 960, Eucm(xi / (1 + xi), 1.0))
    np.testing.assert_allclose(camera.project(points), expected)


def test_every_model_can_be_named_and_says_what_it_is():
    assert set(get_args(LensModel)) == MODELS.keys()
    assert not MODELS.keys() & SYNONYMS.keys()
    for name, model in MODELS.items():
        assert model.ros_name == name
        assert {*model.radial, *model.tangential, *model.always, *model.limits} <= set(model.names())
        assert len(model.start) in (0, len(model.names()))
