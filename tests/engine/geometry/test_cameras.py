from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob

MODELS = [
    PlumbBob(),
    PlumbBob(k1=-0.3, k2=0.1),
    PlumbBob(p1=0.01, p2=-0.02),
    PlumbBob(k1=-0.28, k2=0.07, p1=0.0002, p2=0.00002, k3=0.01),
    PlumbBob(k1=0.1, k2=-0.05, p1=-0.003, p2=0.004, k3=0.02),
]
CAMERAS = [Camera(554.25, 550.0, 320.5, 240.5, 640, 480, model) for model in MODELS]


def grid(half_width: float = 0.55) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(-half_width, half_width, 21), np.linspace(-0.4, 0.4, 17))
    return x, y


@pytest.mark.parametrize("camera", CAMERAS)
def test_projection_is_opencvs(camera):
    points = np.random.default_rng(0).uniform([-1, -0.8, 1.5], [1, 0.8, 4], (300, 3))
    d = camera.distortion
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.K, np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
    )
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), rtol=0, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_the_jacobian_of_the_distortion_is_the_numerical_one(model):
    x, y = grid()
    (xd, yd), ((xx, xy), (_, yy)) = model.distort_with_jacobian(np.stack([x, y]))
    plain = model.distort(x, y)
    np.testing.assert_allclose((xd, yd), plain, atol=1e-15)
    h = 1e-6

    def slope(dx, dy):
        (a, b), (c, d) = model.distort(x + dx, y + dy), model.distort(x - dx, y - dy)
        return (a - c) / (2 * h), (b - d) / (2 * h)

    by_x, by_y = slope(h, 0), slope(0, h)
    for numerical, analytical in zip((*by_x, *by_y), (xx, xy, xy, yy), strict=True):
        np.testing.assert_allclose(np.broadcast_to(analytical, x.shape), numerical, atol=1e-8)


@pytest.mark.parametrize("camera", [replace(camera, skew=-0.7) for camera in (CAMERAS[0], CAMERAS[4])])
def test_columns_may_lean(camera):
    points = np.random.default_rng(0).uniform([-1, -0.8, 1.5], [1, 0.8, 4], (300, 3))
    x, y = np.moveaxis(points[:, :2] / points[:, 2:], -1, 0)
    xd, yd = camera.distortion.distort(x, y)
    homogeneous = np.stack([xd, yd, np.ones_like(xd)], -1) @ camera.K.T
    np.testing.assert_allclose(camera.project(points), homogeneous[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(camera.normalise(homogeneous[:, :2]), np.stack([x, y], -1), rtol=0, atol=1e-12)
    steps = 1e-6 * np.eye(3)
    numerical = [(camera.project(points + step) - camera.project(points - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(camera.slopes(points.T), np.transpose(numerical, (2, 0, 1)), atol=1e-5)
    k1 = len(camera.parameters[:4])
    bent = camera.with_intrinsics(camera.intrinsics + 1e-7 * (np.arange(len(camera.intrinsics)) == k1))
    expected = (bent.to_pixels(x, y) - camera.to_pixels(x, y)).T / 1e-7
    np.testing.assert_allclose(camera.derivatives(x, y)[k1], expected, atol=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_undistort_undoes_distort(model):
    x, y = grid()
    back = model.undistort(*model.distort(x, y))
    np.testing.assert_allclose(back, (x, y), atol=1e-13)


def test_identity_is_known():
    assert PlumbBob().is_identity
    for name in ("k1", "k2", "p1", "p2", "k3"):
        assert not PlumbBob(**{name: 1e-9}).is_identity


@pytest.mark.parametrize("camera", CAMERAS)
def test_normalise_undoes_to_pixels(camera):
    pixels = np.random.default_rng(1).uniform([0, 0], [640, 480], (4, 50, 2))
    rays = camera.normalise(pixels)
    np.testing.assert_allclose(camera.to_pixels(rays[..., 0], rays[..., 1]), pixels, atol=1e-9)


def test_the_principal_ray_meets_the_principal_point():
    camera = CAMERAS[-1]
    np.testing.assert_allclose(camera.project(np.array([0.0, 0.0, 2.0])), [320.5, 240.5])


@pytest.mark.parametrize("z", [0.0, -1.0, np.nan])
def test_points_that_are_not_in_front_have_no_pixel(z):
    pixels = CAMERAS[1].project(np.array([[0.1, 0.1, z], [0.1, 0.1, 1.0]]))
    assert np.isnan(pixels[0]).all()
    assert np.isfinite(pixels[1]).all()


def test_the_image_ends_at_the_edges_of_its_outer_pixels():
    camera = CAMERAS[0]
    inside = [[-0.5, -0.5], [639.5, 479.5], [100, 100]]
    outside = [[-0.51, 0], [0, -0.51], [639.51, 0], [0, 479.51], [np.nan, 0]]
    assert camera.contains(np.array(inside)).all()
    assert not camera.contains(np.array(outside)).any()


def test_what_can_be_seen():
    """Strong barrel distortion folds what lies far outside back into the image."""
    camera = Camera(300.0, 300.0, 320.0, 240.0, 640, 480, PlumbBob(k1=-0.3))
    points = np.array([[0.1, 0.2, 1.0], [0.1, 0.2, -1.0], [0.1, 0.2, 0.0], [1.7, 0.0, 1.0], [0.0, 0.0, np.nan]])
    pixels, visible = camera.project_visible(points)
    assert visible.tolist() == [True, False, False, False, False]
    np.testing.assert_array_equal(pixels, camera.project(points))
    assert camera.contains(pixels[3])  # folded back


def test_undistorting_what_no_point_distorts_to_is_nan_and_nothing_else() -> None:
    model = PlumbBob(k1=-0.3)  # r (1 - 0.3 r^2) has its maximum, 0.703, at r = 1.054
    x, y = np.array([0.1, 0.69, 0.75, 3.0]), np.zeros(4)
    u, v = model.undistort(x, y)
    assert np.isnan(u).tolist() == np.isnan(v).tolist() == [False, False, True, True]
    np.testing.assert_allclose(model.distort(u[:2], v[:2])[0], x[:2], atol=1e-12)
