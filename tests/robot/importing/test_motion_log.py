"""Frames of a recording over time: between records, in motion, and of joints that mimic or that no position tells."""

from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import distance, retract
from calibration.robot.importing.bags.motion import MotionLog

URDF = b"""<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/></joint>
<joint name="follow" type="prismatic"><parent link="a"/><child link="c"/>
  <mimic joint="slide" multiplier="-2" offset="0.5"/></joint>
<joint name="toss" type="floating"><parent link="a"/><child link="d"/></joint></robot>"""

EDGE = ("world", "hand")
MOTION = np.array(
    [[0.2, -0.1, 0.3, 0.4, 0.1, -0.3], [0.5, 0.4, -0.2, -0.6, 0.3, 0.2], [1.0, -2.0, 1.0, 2.0, 1.0, -1.0]]
)
"""Velocity, acceleration and jerk at `NOW`."""
NOW = 10.0
"""s."""


def hand_at(time: float) -> Array:
    after = time - NOW
    return retract(np.eye(4), np.array([after, after**2 / 2, after**3 / 6]) @ MOTION)


def moving_hand(rate: float, late: float = 0.004) -> MotionLog:
    """Records of a hand, a second before and after `NOW`."""
    made = MotionLog()
    for i in range(int(2 * rate)):
        time = NOW - 1 + i / rate + late
        made.add_transform(EDGE, int(1e9 * time), hand_at(time))
    return made


@pytest.mark.parametrize(("rate", "limit"), [(20, 1e-4), (100, 1e-6)])
def test_a_pose_is_on_a_curve_through_the_records_around_it(rate: float, limit: float) -> None:
    m, rad = distance(moving_hand(rate).transform(EDGE, 1e9 * (NOW + 0.1)), hand_at(NOW + 0.1))
    assert max(m, rad) < limit


@pytest.mark.parametrize("rate", [20, 100])
def test_a_motion_has_its_acceleration(rate: float) -> None:
    found = moving_hand(rate).motion(EDGE, 1e9 * NOW)
    np.testing.assert_allclose(found[0], MOTION[0], atol=1e-3)
    np.testing.assert_allclose(found[1], MOTION[1], atol=0.05)


def test_few_records_have_a_velocity_alone() -> None:
    found = moving_hand(10).motion(EDGE, 1e9 * NOW)
    np.testing.assert_allclose(found[0], MOTION[0], atol=0.1)
    assert not found[1:].any()


def test_what_stands_has_no_motion() -> None:
    made = MotionLog()
    for i in range(200):
        made.add_transform(EDGE, int(1e9 * (NOW - 1 + i / 100)), retract(np.eye(4), np.full(6, 1e-5 * (-1) ** i)))
    assert not made.motion(EDGE, 1e9 * NOW).any()
    assert not made.motion(EDGE, 1e9 * (NOW + 60)).any()  # nothing was recorded then


def test_a_curve_does_not_reach_over_a_gap() -> None:
    made = MotionLog()
    for time, x in ((0.0, 0.0), (0.5, 1.0), (0.6, 1.1), (0.7, 1.2)):
        made.add_joint_position("slide", int(1e9 * time), x)
    made.add_robot(URDF, Path("robot.urdf"))
    assert made.transform(("a", "b"), 0.55e9)[0, 3] == pytest.approx(1.05)


def log(**positions: float) -> MotionLog:
    made = MotionLog()
    made.add_robot(URDF, Path("robot.urdf"))
    for name, position in positions.items():
        made.add_joint_position(name, 0, position)
    return made


def test_a_joint_follows_the_recorded_one_that_it_mimics() -> None:
    assert log(slide=0.2).transform(("a", "c"), 0)[0, 3] == pytest.approx(0.5 - 2 * 0.2)


def test_its_own_recorded_position_comes_first() -> None:
    assert log(slide=0.2, follow=0.3).transform(("a", "c"), 0)[0, 3] == pytest.approx(0.3)


def test_the_joint_that_was_not_recorded_is_named() -> None:
    with pytest.raises(InputError, match="no position of joint 'slide' and no transform from 'a' to 'c'"):
        log().transform(("a", "c"), 0)


def test_a_floating_joint_needs_a_transform() -> None:
    with pytest.raises(InputError, match="joint 'toss' is floating: it needs a transform from 'a' to 'd'"):
        log(slide=0.2).transform(("a", "d"), 0)
    recorded = log(slide=0.2)
    recorded.add_transform(("a", "d"), 0, np.eye(4))
    np.testing.assert_array_equal(recorded.transform(("a", "d"), 0), np.eye(4))
