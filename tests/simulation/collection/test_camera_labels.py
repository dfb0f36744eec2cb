import math

import numpy as np
import pytest

from calibration.dataset.pattern import Pattern, grid, outline
from calibration.geometry.cameras import Camera, PlumbBob
from calibration.geometry.transforms import from_xyz_rpy
from calibration.simulation.collection.camera_labels import corners_in_image, facing, label_corners
from calibration.simulation.random_streams import stream
from calibration.simulation.sensors import SimulatedCamera

CAMERA = Camera(550, 550, 320.5, 240.5, 640, 480)
BOARD = Pattern(
    "p",
    "charuco",
    "p",
    "world",
    False,
    grid(11, 8, 0.06, (0.06, 0.06)),
    outline(11, 8, 0.06, (0.04, 0.03), (0.06, 0.06)),
)
NOTHING = np.zeros(88, bool)


def in_front(x: float = 0.0, tilt: float = 0.0, distance: float = 1.5) -> np.ndarray:
    T = from_xyz_rpy([0.0, 0, 0], [0, tilt, 0])
    T[:3, 3] = np.array([x, 0, distance]) - T[:3, :3] @ BOARD.centre
    return T


def test_noise_is_what_was_asked_for() -> None:
    sensor = SimulatedCamera(CAMERA, noise=0.3)
    exact = CAMERA.project(BOARD.corners + in_front()[:3, 3])
    errors = []
    for i in range(100):
        labels = label_corners(sensor, BOARD, in_front(), NOTHING, stream(0, i))
        assert labels is not None
        assert labels.ids.tolist() == list(range(88))
        errors.append(labels.pixels - exact)
    assert np.std(errors) == pytest.approx(0.3, rel=0.01)
    assert abs(np.mean(errors)) < 0.01
    assert (np.round(labels.pixels, 4) == labels.pixels).all()


def test_what_is_seen_does_not_change_the_noise_of_the_rest() -> None:
    sensor = SimulatedCamera(CAMERA)
    whole = label_corners(sensor, BOARD, in_front(), NOTHING, stream(0, 1))
    part = label_corners(sensor, BOARD, in_front(), np.arange(88) % 2 == 0, stream(0, 1))
    assert whole is not None
    assert part is not None
    assert part.ids.tolist() == list(range(1, 88, 2))
    np.testing.assert_array_equal(part.pixels, whole.pixels[1::2])


def test_partial_views_and_the_quarter_rule() -> None:
    sensor = SimulatedCamera(CAMERA, noise=0.0)
    counts = []
    for x in np.linspace(0, 1.5, 40):
        labels = label_corners(sensor, BOARD, in_front(x), NOTHING, stream(0))
        counts.append(len(labels.ids) if labels else 0)
        if labels:
            assert CAMERA.contains(labels.pixels).all()
    assert counts[0] == 88
    assert counts[-1] == 0
    assert sorted({c for c in counts if 0 < c < 88}) == [24, 32, 40, 48, 56, 64, 72, 80]  # more than 22
    hidden = np.arange(88) >= 22
    assert label_corners(sensor, BOARD, in_front(), hidden, stream(0)) is None
    hidden[40] = False
    assert label_corners(sensor, BOARD, in_front(), hidden, stream(0)) is not None


def test_a_label_is_on_the_image_with_its_noise() -> None:
    sensor = SimulatedCamera(CAMERA, noise=20.0)
    for i in range(20):
        labels = label_corners(sensor, BOARD, in_front(0.3), NOTHING, stream(5, i))
        assert labels is not None
        assert CAMERA.contains(labels.pixels).all()


@pytest.mark.parametrize(("degrees", "seen"), [(0, True), (70, True), (80, False), (100, False), (180, False)])
def test_the_pattern_must_face_the_camera(degrees: float, seen: bool) -> None:
    T = in_front(tilt=math.radians(degrees))
    assert facing(T, BOARD.centre) == seen
    assert (label_corners(SimulatedCamera(CAMERA), BOARD, T, NOTHING, stream(0)) is not None) == seen


def test_behind_the_camera_nothing_is_seen() -> None:
    assert label_corners(SimulatedCamera(CAMERA), BOARD, in_front(distance=-1.5), NOTHING, stream(0)) is None


def test_points_that_a_distortion_folds_into_the_image_are_not_on_it() -> None:
    camera = Camera(550, 550, 320.5, 240.5, 640, 480, PlumbBob(k1=-0.4))
    pixels, visible = corners_in_image(camera, np.array([[0.3, 0, 1.0], [1.5, 0, 1.0], [0, 0, -1.0]]))
    assert camera.contains(pixels).tolist() == [True, True, False]
    assert visible.tolist() == [True, False, False]
