import numpy as np
import pytest

from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.rendering.background import STEPS_PER_GREY_LEVEL
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.simulation.rendering.views import camera, perfect

CAMERA = camera()


def flat(level: float, width: int = 320, height: int = 240) -> np.ndarray:
    return np.full((height, width, 3), level * STEPS_PER_GREY_LEVEL, np.uint16)


def test_a_perfect_camera_takes_what_is_there() -> None:
    radiance = flat(0)
    radiance[..., 0], radiance[..., 2] = (
        np.arange(320) % 256 * STEPS_PER_GREY_LEVEL,
        7 * STEPS_PER_GREY_LEVEL + STEPS_PER_GREY_LEVEL // 3,
    )
    image = perfect(CAMERA).expose(radiance, stream(0))
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image[5, :, 0], np.arange(320) % 256)
    assert (image[..., 1] == 0).all()
    assert (image[..., 2] == 7).all()


def test_noise_is_gaussian_and_the_same_on_all_colours() -> None:
    image = SimulatedCamera(CAMERA, blur=0.0, noise=5.0, vignetting=0.0).expose(flat(128), stream(3)).astype(float)
    np.testing.assert_array_equal(image[..., 0], image[..., 2])
    noise = image[..., 1] - 128
    assert noise.mean() == pytest.approx(0, abs=0.08)
    assert noise.std() == pytest.approx(np.hypot(5, 1 / np.sqrt(12)), rel=0.01)
    assert (noise[:, 1:] * noise[:, :-1]).mean() == pytest.approx(0, abs=0.3)
    assert (noise**4).mean() / noise.var() ** 2 == pytest.approx(3, abs=0.1)


def test_noise_depends_on_the_generator_alone() -> None:
    sensor = SimulatedCamera(CAMERA, blur=0.0, vignetting=0.0)
    difference = sensor.expose(flat(100), stream(1)).astype(int) - sensor.expose(flat(60), stream(1))
    assert (difference == 40).all()
    assert (sensor.expose(flat(100), stream(1)) != sensor.expose(flat(100), stream(2))).mean() > 0.5


def test_light_beyond_the_range_is_white_and_darkness_black() -> None:
    sensor = SimulatedCamera(CAMERA, noise=3.0)
    assert (sensor.expose(flat(600), stream(0)) == 255).all()
    assert 0 < sensor.expose(flat(0), stream(0)).mean() < 3


@pytest.mark.parametrize("exposure", [0.0, 0.5, 1.0, 2.0])
def test_exposure_is_a_factor(exposure: float) -> None:
    sensor = SimulatedCamera(CAMERA, blur=0.0, noise=0.0, vignetting=0.0, exposure=exposure)
    assert (sensor.expose(flat(80), stream(0)) == round(80 * exposure)).all()


def test_vignetting_darkens_the_corners_by_its_amount() -> None:
    sensor = SimulatedCamera(CAMERA, blur=0.0, noise=0.0, vignetting=0.4)
    image = sensor.expose(flat(200), stream(0))[..., 0].astype(int)
    assert image[120, 160] == 200
    assert {image[0, 0], image[0, -1], image[-1, 0], image[-1, -1]} == {120}
    assert (np.diff(image[120, 160:]) <= 0).all()
    np.testing.assert_array_equal(image, image[::-1, ::-1])


def test_vignetting_falls_with_the_fourth_power_of_the_cosine() -> None:
    sensor = SimulatedCamera(CAMERA, blur=0.0, noise=0.0, vignetting=1.0)
    image = sensor.expose(flat(200), stream(0))[..., 0]
    x, y = (np.arange(320) - 159.5) / 300, (np.arange(240)[:, None] - 119.5) / 300
    loss = 1 - np.cos(np.arctan(np.hypot(x, y))) ** 4
    np.testing.assert_allclose(image, 200 * (1 - loss / loss.max()), atol=0.51)


def test_vignetting_keeps_to_the_optical_axis() -> None:
    off_centre = camera()
    off_centre = type(off_centre)(300, 300, 50.0, 60.0, 320, 240)
    sensor = SimulatedCamera(off_centre, blur=0.0, noise=0.0, vignetting=0.5)
    image = sensor.expose(flat(200), stream(0))[..., 0]
    assert image[60, 50] == 200
    assert image[-1, -1] == 100
    assert image[0, 0] > 180


def test_blur_spreads_a_point_as_a_gaussian_and_keeps_its_light() -> None:
    radiance = flat(0, 41, 31)
    radiance[15, 20] = 240 * STEPS_PER_GREY_LEVEL
    sensor = SimulatedCamera(camera(41, 31), blur=1.2, noise=0.0, vignetting=0.0, exposure=1.0)
    image = sensor.expose(radiance, stream(0))[..., 1].astype(float)
    y, x = np.mgrid[:31, :41]
    expected = 240 * np.exp(-((y - 15) ** 2 + (x - 20) ** 2) / 2 / 1.2**2) / (2 * np.pi * 1.2**2)
    np.testing.assert_allclose(image, expected, atol=0.7)
    np.testing.assert_array_equal(image, image[::-1, ::-1])


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (4, 1), (1, 4), (2, 2)])
def test_the_smallest_images(size: tuple[int, int]) -> None:
    width, height = size
    image = SimulatedCamera(camera(width, height)).expose(flat(100, width, height), stream(0))
    assert image.shape == (height, width, 3)
    assert (abs(image.astype(int) - 95) < 15).all()
