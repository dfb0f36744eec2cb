"""Cameras of a bag against the motion that carries them, and against each other."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration.__main__ import main
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.moving_frames import blamed, checks_of_bag
from calibration.engine.baseline.document import Baseline, write_baseline
from tests.addons.guard.witness.moving_bag import ArmBag, accepted_cameras
from tests.thorough import thorough

TURN = np.radians(0.5)


def checked(bag: ArmBag, folder: Path) -> dict[str, SensorCheck]:
    """What is said of its cameras."""
    return {each.sensor: each for each in checks_of_bag(bag.write(folder / "arm.bag"), accepted_cameras())}


def test_check_is_red_of_a_bag_in_which_the_camera_in_the_hand_turned(tmp_path: Path) -> None:
    bag, baseline = (
        ArmBag(18, shift=(0, 0, 0, 0, TURN, 0), begin=9).write(tmp_path / "arm.bag"),
        tmp_path / "accepted.json",
    )
    write_baseline(baseline, Baseline(1, {"arm": accepted_cameras()}))
    output = tmp_path / "output"
    assert main(["check", str(bag), "--baseline", str(baseline), "--output", str(output)]) == 1
    [found] = json.loads((output / "results.json").read_text())["systems"]["arm"]
    assert (found["sensor"], found["outcome"]) == ("hand", "moved")
    assert found["since"] == pytest.approx(4.25, abs=1.0)
    assert found["rotation_deg"] == pytest.approx([0.0, 0.5, 0.0], abs=0.1)


@pytest.mark.thorough
def test_a_camera_in_the_hand_that_stays_is_unmoved(tmp_path: Path) -> None:
    found = checked(ArmBag(16), tmp_path)["hand"]
    assert (found.outcome, found.red) == ("unmoved", False)
    assert found.unseen_deg is not None
    assert found.unseen_deg < 0.5


def test_of_two_cameras_on_a_body_that_stands_the_turned_one_is_seen_by_the_other(tmp_path: Path) -> None:
    bag = ArmBag(9, shift_of_other=(0, 0, 0, TURN, 0, 0), cameras=("hand", "other"), arm_moves=False)
    found = checked(bag, tmp_path)
    assert found["hand"].outcome == "cannot-tell"  # nothing moves it
    assert found["other"].red
    assert found["other"].rotation_deg == pytest.approx((0.5, 0.0, 0.0), abs=0.15)


@pytest.mark.parametrize(
    "bag",
    [ArmBag(9, arm_moves=False), thorough(ArmBag(9, textured=0.0)), thorough(ArmBag(4))],
    ids=["no motion", "no texture", "few images"],
)
def test_a_recording_that_cannot_tell_says_so(bag: ArmBag, tmp_path: Path) -> None:
    found = checked(bag, tmp_path)["hand"]
    assert found.outcome == "cannot-tell"
    assert found.reason


def pair(first: str, second: str, outcome: str) -> tuple[str, SensorCheck]:
    """What was found of a pair."""
    check = SensorCheck(sensor=second, method="", outcome=outcome, reason="it is turned")  # type: ignore[arg-type]
    return first, check


def test_of_three_cameras_the_one_that_differs_from_both_others_has_moved() -> None:
    found = blamed([pair("a", "b", "moved"), pair("a", "c", "moved"), pair("b", "c", "unmoved")])
    assert {each.sensor: each.red for each in found} == {"a": True, "b": False, "c": False}


def test_of_two_cameras_either_may_have_moved() -> None:
    (found,) = blamed([pair("a", "b", "moved")])
    assert found.sensor == "b"
    assert "or a" in found.reason
