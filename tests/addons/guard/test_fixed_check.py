"""A fixed camera against its reference: told apart are turned, moved, zoomed, out of focus, and what cannot be told."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.guard.clips import Displacement, as_recorded
from calibration.addons.guard.fixed_check import check_fixed_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.base import InputError
from calibration.robot.labelling.detection import Image
from tests.addons.guard.recorded import CHANGE, clip, reference
from tests.thorough import thorough


def checked(images: Sequence[Image]) -> SensorCheck:
    return check_fixed_camera(reference(), as_recorded(list(images)))


def test_people_light_and_moved_things_are_not_red() -> None:
    found = checked(clip())
    assert found.outcome == "unmoved", found.reason
    assert found.unseen_deg is not None
    assert found.unseen_deg < 0.05


@pytest.mark.parametrize(
    ("rotation", "words"),
    [((0.0, 0.3, 0.0), "about y (to the right)"), thorough((-0.05, 0.0, 0.0), "about x (down)")],
)
def test_a_turn_is_told_with_its_axis_size_and_moment(rotation: tuple[float, float, float], words: str) -> None:
    found = checked(clip(Displacement(rotation), CHANGE))
    assert (found.outcome, found.since) == ("moved", CHANGE), found.reason
    assert words in found.reason
    assert found.rotation_deg is not None
    assert found.rotation_sigma_deg is not None
    errors = np.abs(np.subtract(found.rotation_deg, rotation)) / found.rotation_sigma_deg
    assert errors.max() < 4
    assert found.translation_percent is None


@pytest.mark.thorough
def test_one_that_was_turned_before_is_red_all_along() -> None:
    found = checked(clip(Displacement((0.0, 0.3, 0.0)), 0.0))
    assert (found.outcome, found.since) == ("moved", None)


def test_a_step_to_the_side_is_told_by_parallax() -> None:
    found = checked(clip(Displacement(translation_m=(0.05, 0.0, 0.0)), 0.0))
    assert found.outcome == "moved"
    assert found.translation_percent is not None
    x, y, z = found.translation_percent
    assert 0.7 < x < 5  # of a room of 3 to 6 m
    assert math.hypot(y, z) < 0.1 * x


def test_a_longer_focal_length_is_no_turn() -> None:
    found = checked(clip(Displacement(zoom=0.01), 0.0))
    assert found.outcome == "lens-changed"
    assert found.focal_percent == pytest.approx(1.0, abs=0.1)


def test_what_is_out_of_focus_is_said() -> None:
    found = checked(clip(Displacement(blur_px=2.0), 0.0))
    assert found.outcome == "lens-changed"
    assert "out of focus" in found.reason


@pytest.mark.parametrize(
    ("images", "reason"),
    [
        (lambda: [np.zeros((480, 640), np.uint8)] * 6, "dark"),
        (lambda: [np.full((480, 640), 120, np.uint8)] * 6, "no texture"),
        (lambda: [*clip()[:4], *[np.full((480, 640), 120, np.uint8)] * 3], "from 2.0 s on"),
    ],
    ids=["black", "bare", "covered"],
)
def test_what_cannot_be_told_is_said_with_its_reason(images: Callable[[], list[Image]], reason: str) -> None:
    found = checked(images())
    assert found.outcome == "cannot-tell"
    assert reason in found.reason


@pytest.mark.thorough
def test_a_waved_camera_is_not_fixed() -> None:
    turns = np.random.default_rng(1).normal(0, 1.0, (6, 2)).tolist()
    found = checked([clip(Displacement((x, y, 0.0)), 0.0)[0] for x, y in turns])
    assert found.outcome == "cannot-tell"
    assert "moves all the time" in found.reason


def test_another_resolution_is_another_camera() -> None:
    with pytest.raises(InputError, match="320 x 240 pixels, expected 640 x 480"):
        checked([image[::2, ::2] for image in clip()])


def test_a_reference_without_features_tells_nothing() -> None:
    bare = replace(reference(), pixels="", descriptors="")
    assert check_fixed_camera(bare, as_recorded(list(clip()))).outcome == "cannot-tell"


@pytest.mark.thorough
def test_a_turn_in_the_last_images_is_not_green() -> None:
    turned = clip(Displacement((0.0, 0.3, 0.0)), CHANGE)
    found = checked([*clip(), turned[-1]])
    assert found.outcome == "cannot-tell"
    assert "from 3.0 s on" in found.reason
