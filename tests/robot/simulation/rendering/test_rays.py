import numpy as np

from calibration.engine.geometry.lenses import Equidistant, PlumbBob, Rational
from calibration.robot.simulation.rendering.background import SAMPLES_PER_PIXEL, rays, rounded, sample_rays
from tests.robot.simulation.rendering.views import DISTORTION, T_WORLD_CAMERA, camera


def test_rays_of_pixels_and_of_one_more_on_each_side() -> None:
    for distortion in (PlumbBob(), DISTORTION, Rational(0.2, 0.1, k4=0.4), Equidistant(-0.02, 0.01)):
        of = camera(20, 10, 15, distortion)
        found = rays(of)
        assert found.shape == (3, 12, 22)
        pixels = of.project(np.moveaxis(found, 0, -1))
        v, u = np.mgrid[-1:11, -1:21]
        np.testing.assert_allclose(pixels, np.stack([u, v], -1), atol=1e-9)


def test_no_ray_where_the_lens_shows_nothing() -> None:
    found = rays(camera(320, 240, 100, PlumbBob(-0.45, 0.0, 0.0, 0.0, 0.0)))
    assert np.isnan(found[:, 0, 0]).all()
    np.testing.assert_array_equal(found[2, 100:140, 140:180], 1)


def test_a_fisheye_lens_shows_what_lies_before_the_camera_and_beside_it() -> None:
    """Rays up to pi from the axis: a circle of 314 pixels for a focal length of 100."""
    found = rays(camera(700, 700, 100, Equidistant()))
    v, u = np.mgrid[-1:701, -1:701] - 349.5
    radius = np.hypot(u, v)
    np.testing.assert_array_equal(np.isfinite(found[0]), radius < 100 * np.pi)
    front, behind = radius < 150, (radius > 50 * np.pi) & (radius < 100 * np.pi)
    np.testing.assert_allclose(np.hypot(found[0], found[1])[front], np.tan(radius[front] / 100), rtol=1e-9)
    np.testing.assert_array_equal(found[2][front], 1)
    np.testing.assert_allclose(found[2][behind], np.cos(radius[behind] / 100), atol=1e-9)


def test_samples_lie_evenly_in_their_pixel() -> None:
    of = camera(20, 10, 15)
    rows, columns = np.array([3, 7]), np.array([0, 19])
    pixels = of.project(np.moveaxis(sample_rays(of, rows, columns), 0, -1))
    offset = pixels - np.stack([columns, rows], -1)
    assert offset.shape == (SAMPLES_PER_PIXEL, 2, 2)
    for axis in range(2):
        np.testing.assert_allclose(np.sort(offset[:, 0, axis]), (np.arange(16) - 7.5) / 16, atol=1e-9)
    fields = np.floor((offset[:, 0] + 0.5) * 4) @ [4, 1]
    assert sorted(fields) == list(range(16))
    np.testing.assert_allclose(np.sort(-offset[:, 0], axis=0), np.sort(offset[:, 0], axis=0), atol=1e-9)


def test_a_pose_is_rounded_to_a_picometre() -> None:
    pose = np.round(T_WORLD_CAMERA, 9)
    np.testing.assert_array_equal(rounded(pose + 4e-13), rounded(pose))
    np.testing.assert_allclose(rounded(T_WORLD_CAMERA), T_WORLD_CAMERA, rtol=0, atol=1e-12)
