"""Frames of a recording that come from joints: those that mimic others, and those that no position tells."""

from pathlib import Path

import numpy as np
import pytest

from calibration.base.errors import InputError
from calibration.robot.importing.bags.motion_log import MotionLog

URDF = b"""<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/></joint>
<joint name="follow" type="prismatic"><parent link="a"/><child link="c"/>
  <mimic joint="slide" multiplier="-2" offset="0.5"/></joint>
<joint name="toss" type="floating"><parent link="a"/><child link="d"/></joint></robot>"""


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
    with pytest.raises(InputError, match="floating joint 'toss' needs a transform from 'a' to 'd'"):
        log(slide=0.2).transform(("a", "d"), 0)
    recorded = log(slide=0.2)
    recorded.add_transform(("a", "d"), 0, np.eye(4))
    np.testing.assert_array_equal(recorded.transform(("a", "d"), 0), np.eye(4))
