"""Tsai, Park, Horaud, Andreff and Daniilidis on datasets."""

import numpy as np
import pytest

from calibration.comparison import hand_eye_methods
from calibration.comparison.methods import METHODS
from calibration.dataset.reading import read_dataset
from calibration.errors import InputError, UndeterminedError
from calibration.geometry.transforms import distance
from tests.comparison.test_robot_world_methods import MOUNT, disturbed, still_arm
from tests.evaluation.scene import arm, two_cameras

NAMES = ("tsai", "park", "horaud", "andreff", "daniilidis")
EACH = pytest.mark.parametrize("name", NAMES)


@EACH
@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_an_exact_arm_gives_the_exact_camera_and_pattern(name, eye_in_hand):
    dataset = arm(seed=1, eye_in_hand=eye_in_hand)
    board = ("world" if eye_in_hand else "flange", "board_link")
    found = METHODS[name].run(disturbed(dataset, MOUNT, board))
    changed = [edge for edge in dataset.transforms if found.transforms[edge] is not dataset.transforms[edge]]
    assert {MOUNT, board} <= set(changed)
    for edge in dataset.transforms:
        np.testing.assert_allclose(found.transforms[edge], dataset.transforms[edge], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "millimetres", "degrees"),
    [
        ("park", 0.371, 0.0329),  # as ATOM itself, where OpenCV solves them
        ("andreff", 0.621, 0.0286),
        ("horaud", 0.373, 0.0311),  # as OpenCV on the same views
        ("daniilidis", 0.423, 0.0325),
        ("tsai", 0.373, 0.0311),  # OpenCV 4.14, which leaves out motions: 0.775, 0.0391
    ],
)
def test_the_synthetic_arm_gives_the_known_figures(shared_data, name, millimetres, degrees):
    dataset = read_dataset(shared_data / "synthetic" / "riwbot")
    edge = dataset.sensors["rgb_world"].edge
    translation, angle = distance(dataset.transforms[edge][0], METHODS[name].run(dataset).transforms[edge][0])
    assert 1000 * translation == pytest.approx(millimetres, abs=6e-4)
    assert np.degrees(angle) == pytest.approx(degrees, abs=6e-5)


@EACH
def test_an_arm_that_turns_too_little_is_refused(name):
    with pytest.raises(UndeterminedError, match="the arm turns about one axis only"):
        METHODS[name].run(arm(seed=5, noise=0.1, axis=np.array([0.0, 0.0, 1.0])))
    with pytest.raises(UndeterminedError, match="the arm does not turn"):
        METHODS[name].run(still_arm())


@EACH
def test_what_has_no_arm_is_told(name):
    with pytest.raises(InputError, match="does not apply: it needs a pattern fixed to the world or to an arm"):
        METHODS[name].run(two_cameras(n=3)[0])


def test_the_names_are_the_functions():
    for name in NAMES:
        assert METHODS[name].run is getattr(hand_eye_methods, name)
