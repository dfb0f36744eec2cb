import math

import numpy as np
import pytest

from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.sensors.sensor import MAX_VIEW_ANGLE, corners_in_image, facing

CENTRE = np.array([0.3, 0.2, 0.0])


def in_front(tilt: float, distance: float = 1.5) -> np.ndarray:
    """A pattern whose centre is straight ahead, turned about the camera's y axis."""
    T = from_xyz_rpy([0.0, 0, 0], [0, tilt, 0])
    T[:3, 3] = np.array([0, 0, distance]) - T[:3, :3] @ CENTRE
    return T


@pytest.mark.parametrize(("degrees", "seen"), [(0, True), (64, True), (66, False), (90, False), (180, False)])
def test_the_pattern_must_face_the_camera(degrees: float, seen: bool) -> None:
    assert math.degrees(MAX_VIEW_ANGLE) == pytest.approx(65)
    for sign in (1, -1):
        assert facing(in_front(sign * math.radians(degrees)), CENTRE) == seen


def test_the_angle_is_that_of_the_line_of_sight() -> None:
    # a pattern that is square to the axis, seen from 60 and from 70 degrees aside
    aside = [np.array([1.5 * math.tan(math.radians(angle)), 0, 1.5]) for angle in (60, 70)]
    T = np.stack([from_xyz_rpy(place - CENTRE, [0.0, 0, 0]) for place in aside])
    assert facing(T, CENTRE).tolist() == [True, False]


def test_corners_on_the_image() -> None:
    camera = Camera(500, 500, 320, 240, 640, 480)
    points = np.array([[0, 0, 1.0], [0.63, 0, 1.0], [0.65, 0, 1.0], [0, 0, -1.0]])
    pixels, visible = corners_in_image(camera, points)
    assert visible.tolist() == [True, True, False, False]
    np.testing.assert_allclose(pixels[:3], [[320, 240], [635, 240], [645, 240]])
    assert np.isnan(pixels[3]).all()


def test_points_that_a_distortion_folds_into_the_image_are_not_on_it() -> None:
    camera = Camera(550, 550, 320.5, 240.5, 640, 480, PlumbBob(k1=-0.4))
    pixels, visible = corners_in_image(camera, np.array([[0.3, 0, 1.0], [1.5, 0, 1.0], [0, 0, -1.0]]))
    assert camera.contains(pixels).tolist() == [True, True, False]
    assert visible.tolist() == [True, False, False]
