import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import (
    MODELS,
    Distortion,
    DoubleSphere,
    Equidistant,
    Eucm,
    Omni,
    PlumbBob,
    Rational,
)

LENSES: list[Distortion] = [
    PlumbBob(),
    PlumbBob(k1=-0.28, k2=0.07, p1=0.0002, p2=0.00002, k3=0.01),
    Rational(),
    Rational(0.1, -0.05, -0.003, 0.004, 0.02),
    Rational(0.5, 0.1, 0.001, -0.002, 0.02, 0.8, 0.3, 0.05),
    Equidistant(),
    Equidistant(-0.02, 0.01, -0.003, 0.001),
    Equidistant(0.1, 0.05),
    DoubleSphere(-0.2, 0.59),
    DoubleSphere(0.3, 0.4),
    Eucm(0.6, 1.1),
    Eucm(0.4, 0.8),
    Omni(1.5, -0.2, 0.05, 0.001, -0.002),
    Omni(0.8),
]
IDS = [f"{lens.ros_name}-{i}" for i, lens in enumerate(LENSES)]


def test_every_model_is_tested() -> None:
    assert {type(lens) for lens in LENSES} == set(MODELS.values())


def coordinates(half_width: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """A grid about the axis, with points on it and very near it."""
    x, y = np.meshgrid(np.linspace(-half_width, half_width, 21), np.linspace(-0.5, 0.5, 17))
    near = np.array([1e-12, 1e-7, 1e-4, 0.05, 0.0999999, 0.1000001])
    return np.concatenate([x.ravel(), near]), np.concatenate([y.ravel(), np.zeros(6)])


PINHOLES_AND_FISHEYES = [lens for lens in LENSES if isinstance(lens, PlumbBob | Rational | Equidistant)]


@pytest.mark.parametrize("lens", PINHOLES_AND_FISHEYES, ids=str)
def test_projection_is_opencvs(lens):
    camera = Camera(554.25, 550.0, 320.5, 240.5, 640, 480, lens)
    points = np.random.default_rng(0).uniform([-1, -0.8, 1.0], [1, 0.8, 4], (300, 1, 3))
    project = cv2.fisheye.projectPoints if isinstance(lens, Equidistant) else cv2.projectPoints
    expected, _ = project(points, np.zeros(3), np.zeros(3), camera.K, lens.coefficients)
    np.testing.assert_allclose(camera.project(points[:, 0]), expected.reshape(-1, 2), rtol=0, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_the_derivatives_are_the_numerical_ones(lens):
    x, y = coordinates()
    (xd, yd), ((xx, xy), (yx, yy)) = lens.distort_with_jacobian(np.stack([x, y]))
    np.testing.assert_allclose((xd, yd), lens.distort(x, y), atol=1e-15)
    h = 1e-6
    by_x = (np.array(lens.distort(x + h, y)) - lens.distort(x - h, y)) / (2 * h)
    by_y = (np.array(lens.distort(x, y + h)) - lens.distort(x, y - h)) / (2 * h)
    np.testing.assert_allclose(by_x, np.broadcast_arrays(xx, yx), atol=1e-8)
    np.testing.assert_allclose(by_y, np.broadcast_arrays(xy, yy), atol=1e-8)
    for each, step in zip(lens.derivatives(x, y), h * np.eye(len(lens.coefficients)), strict=True):
        above, below = (lens.with_coefficients(lens.coefficients + s) for s in (step, -step))
        numerical = (np.array(above.distort(x, y)) - below.distort(x, y)) / (2 * h)
        np.testing.assert_allclose(each, numerical, atol=1e-8)


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_undistort_undoes_distort(lens):
    x, y = coordinates()
    np.testing.assert_allclose(lens.undistort(*lens.distort(x, y)), (x, y), atol=1e-13)


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_coefficients_and_names(lens):
    assert MODELS[lens.ros_name] is type(lens)
    assert lens.with_coefficients(lens.coefficients) == lens
    assert [getattr(lens, name) for name in lens.names()] == lens.coefficients.tolist()


def test_the_number_and_order_of_coefficients_is_ros_s():
    assert PlumbBob.names() == ("k1", "k2", "p1", "p2", "k3")
    assert Rational.names() == ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    assert Equidistant.names() == ("k1", "k2", "k3", "k4")


def test_only_a_pinhole_leaves_points_where_they_are():
    assert PlumbBob().is_identity
    assert Rational().is_identity
    assert not Equidistant().is_identity
    for name in Rational.names():
        assert not Rational(**{name: 1e-9}).is_identity
    x, y = coordinates()
    assert Rational().undistort(x, y)[0] is x


def test_a_fraction_without_a_denominator_is_plumb_bob():
    x, y = coordinates()
    coefficients = (-0.2, 0.05, 0.001, -0.002, 0.01)
    np.testing.assert_array_equal(Rational(*coefficients).distort(x, y), PlumbBob(*coefficients).distort(x, y))
    # a common factor cancels
    np.testing.assert_allclose(Rational(0.3, k4=0.3).distort(x, y), (x, y), atol=1e-15)


@given(st.floats(0.0, 3.1), st.floats(-np.pi, np.pi))
def test_an_equidistant_radius_is_the_angle(angle, around):
    camera = Camera(1.0, 1.0, 0.0, 0.0, 10, 10, Equidistant())
    ray = np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
    pixel = camera.project(ray)
    assert abs(np.hypot(*pixel) - angle) < 1e-12
    np.testing.assert_allclose(camera.rays(pixel), ray, rtol=1e-9, atol=1e-12)


def test_angles_that_no_ray_has_are_nan():
    x = np.array([1.5, 1.57, 3.14, 3.15, 4.0])
    u, _ = Equidistant().undistort(x, np.zeros(5))
    assert np.isnan(u).tolist() == [False, False, False, True, True]
    # t (1 - 0.3 t^2) has its maximum, 0.703, at t = 1.054
    u, v = Equidistant(-0.3).undistort(np.array([0.1, 0.69, 0.75]), np.zeros(3))
    assert np.isnan(u).tolist() == np.isnan(v).tolist() == [False, False, True]


def test_beyond_a_pole_there_is_no_ray():
    x = np.array([0.5, -0.5, 1.0, -3.0])
    u, _ = Rational(k4=-1.0).undistort(x, np.zeros(4))  # x / (1 - x^2) has a root beyond the pole at 1 too
    assert (np.abs(u) < 1).all()
    np.testing.assert_allclose(u / (1 - u**2), x)


def test_intrinsics_are_one_vector():
    camera = Camera(554.0, 550.0, 320.0, 240.0, 640, 480, Equidistant(0.1, 0.2, 0.3, 0.4))
    assert camera.parameters == ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    assert camera.intrinsics.tolist() == [554.0, 550.0, 320.0, 240.0, 0.1, 0.2, 0.3, 0.4]
    assert camera.with_intrinsics(camera.intrinsics) == camera
    assert camera.with_intrinsics(camera.intrinsics + 1).distortion == Equidistant(1.1, 1.2, 1.3, 1.4)
