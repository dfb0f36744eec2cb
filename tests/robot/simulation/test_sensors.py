import math
import re
from typing import Any

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.records import read
from calibration.engine.geometry.lenses import Equidistant, Rational
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar2d

EYE = "simulation.yml: sensors.eye"
SCAN = "simulation.yml: sensors.scan"


def lens(**entries: Any) -> dict[str, Any]:
    return {"width": 640, "height": 480, "hfov_deg": 60, **entries}


def test_a_camera_has_defaults_for_its_images() -> None:
    camera = read(SimulatedCamera, lens(), EYE)
    assert camera == SimulatedCamera(camera.camera)
    assert (camera.blur, camera.noise, camera.vignetting, camera.exposure) == (0.65, 2.0, 0.1, 1.0)
    assert camera.camera.fx == pytest.approx(320 / math.tan(math.radians(30)))
    assert (camera.camera.cx, camera.camera.cy) == (320.5, 240.5)  # Gazebo's


def test_a_camera_in_full() -> None:
    keys = {"blur_px": 0, "noise_levels": 0.5, "vignetting": 1, "exposure": 2.5, "distortion": [-0.1, 0, 0, 0, 0]}
    camera = read(SimulatedCamera, lens(**keys), EYE)
    assert (camera.blur, camera.noise, camera.vignetting, camera.exposure) == (0, 0.5, 1, 2.5)
    assert camera.camera.distortion.k1 == -0.1


def test_a_lens_of_another_model() -> None:
    fisheye = read(SimulatedCamera, lens(distortion_model="equidistant", distortion=[0.1, 0, 0, 0.2]), EYE).camera
    assert fisheye.distortion == Equidistant(0.1, 0, 0, 0.2)
    assert fisheye.fx == pytest.approx(320 / math.radians(30))  # 640 pixels of 60 degrees, as many for each
    assert read(SimulatedCamera, lens(distortion_model="rational_polynomial"), EYE).camera.distortion == Rational()
    assert read(SimulatedCamera, lens(distortion_model="plumb_bob"), EYE) == read(SimulatedCamera, lens(), EYE)


def test_a_whole_number_may_have_a_point_and_null_is_as_if_the_key_were_absent() -> None:
    assert read(SimulatedCamera, lens(width=640.0, blur_px=None, K=None), EYE) == read(SimulatedCamera, lens(), EYE)


def test_a_depth_camera() -> None:
    usual = read(SimulatedDepthCamera, lens(), EYE)
    assert usual == SimulatedDepthCamera(usual.camera)
    depth = read(SimulatedDepthCamera, lens(range_m=[0.1, 4], noise_m=0.002, noise_per_m2=0), EYE)
    assert (depth.least_range, depth.most_range, depth.noise, depth.noise_growth) == (0.1, 4, 0.002, 0)
    np.testing.assert_array_equal(depth.camera.K, usual.camera.K)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"blur_px": -1}, "blur_px: found -1, expected a number from 0 to 20"),
        ({"noise_levels": math.nan}, "noise_levels: found nan, expected a number from 0 to 255"),
        ({"vignetting": 1.5}, "vignetting: found 1.5, expected a number from 0 to 1"),
        (
            {"distortion_model": "fov"},
            "distortion_model: found 'fov', expected plumb_bob, equidistant",
        ),
        (
            {"distortion_model": "equidistant", "distortion": [0] * 5},
            "distortion: found a list of 5, expected a list of 4: k1, k2",
        ),
        ({"exposure": "bright"}, "exposure: found 'bright', expected a number from 0 to 100"),
        ({"noise_px": 0.3}, "unknown key 'noise_px': did you mean 'noise_levels'? (known: width, height"),
        ({"range_m": [0, 1]}, "unknown key 'range_m'"),
        ({"width": 60_000, "height": 60_000}, "width: found 60000 x 60000 pixels, expected 25000000 at most"),
    ],
)
def test_what_is_wrong_with_a_camera_is_named(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        read(SimulatedCamera, lens(**entries), EYE)
    assert str(error.value).startswith(EYE)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"range_m": [2, 1]}, "range_m: found [2, 1], expected two rising numbers of at least 0"),
        ({"noise_per_m2": -1}, "noise_per_m2: found -1"),
        ({"vignetting": 0.1}, "unknown key 'vignetting' (known: width"),
    ],
)
def test_what_is_wrong_with_a_depth_camera_is_named(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        read(SimulatedDepthCamera, lens(**entries), EYE)
    assert message in str(error.value)


def flat(**keys: Any) -> dict[str, Any]:
    return {"rays": 541, **keys}


def test_a_2d_lidar() -> None:
    usual = read(SimulatedLidar2d, flat(), SCAN)
    assert usual.step == pytest.approx(math.radians(0.5))
    directions, half = usual.directions(), 0.5**0.5
    assert directions.shape == (1, 541, 3)
    np.testing.assert_allclose(directions[0, [0, 270, 540], :2], [[-half, -half], [1, 0], [-half, half]], atol=1e-12)
    assert not directions[..., 2].any()
    lidar = read(SimulatedLidar2d, flat(angle_deg=[0, 180], range_m=[0.2, 10], noise_m=0.03, resolution_m=0), SCAN)
    assert (lidar.least_range, lidar.most_range, lidar.noise, lidar.resolution) == (0.2, 10, 0.03, 0)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"rays": 1}, "rays: found 1, expected a whole number from 8 to 100000"),
        ({"rings": 16}, "unknown key 'rings' (known: rays, angle_deg"),
        (
            {"angle_deg": [-200, 200]},
            "angle_deg: found [-200, 200], expected two rising numbers from -360 to 360, at most 360 apart",
        ),
        ({"angle_deg": [5, 5]}, "angle_deg: found [5, 5]"),
        ({"angle_deg": [5]}, "angle_deg: found a list of 1, expected two"),
        ({"noise_m": -1}, "noise_m: found -1"),
    ],
)
def test_what_is_wrong_with_a_2d_lidar_is_named(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^{SCAN}[.:] ?{re.escape(message)}"):
        read(SimulatedLidar2d, flat(**entries), SCAN)
