"""Parameters fixed by the user are unchanged to the last bit, and the others adapt."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise
from tests.engine.estimation.scenes import errors, pose
from tests.engine.estimation.systems import arm_with_patterns, eye_to_hand, hand_and_world, stereo


@pytest.mark.parametrize(
    ("scene", "hold", "edge"),
    [
        (stereo, "left", ("world", "left")),
        (stereo, "world-right", ("world", "right")),
        (stereo, "board", ("world", "board_link")),
        (eye_to_hand, "board", ("flange", "board_link")),
        (hand_and_world, "world-base", ("world", "base")),
        (arm_with_patterns, "second", ("forearm", "second_link")),
        (arm_with_patterns, "loose", ("world", "loose_link")),
    ],
)
def test_fixed_transforms_are_unchanged_and_the_others_are_found(scene, hold, edge):
    dataset = scene(border=False).dataset()
    exact = calibrate(dataset, Options(hold=(hold,)))
    assert exact.converged, exact.reason
    np.testing.assert_allclose(exact.dataset.transforms[edge], dataset.transforms[edge], atol=1e-15)
    assert edge not in exact.covariances
    assert max(errors(dataset, exact.transforms)) < 1e-9
    assert exact.gauge is None


def test_the_others_adapt_to_a_wrong_fixed_transform():
    dataset = eye_to_hand().dataset()
    wrong = dataset.with_transforms(
        {("flange", "board_link"): dataset.transforms["flange", "board_link"] @ pose(0.01, 0, 0)}
    )
    result = calibrate(wrong, Options(hold=("board",)))
    np.testing.assert_allclose(
        result.transforms["flange", "board_link"], wrong.transforms["flange", "board_link"][0], atol=1e-15
    )
    t, _ = errors(dataset, {edge: T for edge, T in result.transforms.items() if edge == ("world", "cam")})
    assert 1e-3 < t < 0.02


def test_fixed_transforms_get_no_noise():
    dataset = hand_and_world().dataset()
    result = calibrate(dataset, Options(hold=("world-base", "board"), start="given"), StartingNoise(0.05, 0.05))
    assert result.converged
    assert max(errors(dataset, result.transforms)) < 1e-9


def test_a_name_of_nothing_lists_what_there_is():
    with pytest.raises(InputError, match=r"nothing to hold is called 'lefty' \(there are world-left, left, "):
        build(stereo().dataset(), ("lefty",))


def test_a_pattern_without_a_pose_cannot_be_fixed():
    dataset = stereo().dataset()
    poses = dataset.transforms["world", "board_link"].copy()
    poses[3] = np.nan
    with pytest.raises(InputError, match=r"collections/003/transforms: no 'world-board_link', so pattern 'board'"):
        build(dataset.with_transforms({("world", "board_link"): poses}), ("board",))
    absent = {edge: T for edge, T in dataset.transforms.items() if edge[1] != "board_link"}
    with pytest.raises(InputError, match="collections/000/transforms"):
        build(replace(dataset, transforms=absent), ("board",))


def test_nothing_is_left_to_calibrate():
    with pytest.raises(UndeterminedError, match=r"nothing to calibrate.*say what the pattern is fixed to"):
        build(stereo().dataset(), ("left", "right"))
