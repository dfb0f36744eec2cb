"""The methods by name."""

import subprocess
import sys

import pytest

from calibration.base import InputError
from calibration.engine.comparison import COMPARISON_METHODS, method_of
from tests.engine.evaluation.scene import applicable, arm, lidar_and_camera, range_pair, two_cameras


def test_a_method_is_found_by_its_name():
    for name, method in COMPARISON_METHODS.items():
        assert method_of(name) is method
        assert method.name == name
    assert method_of("opencv-stereo").title == "OpenCV stereo"


def test_an_unknown_name_is_told_with_the_known_ones():
    known = r"\(known: opencv-stereo, .*shah, li, tsai, .*icp-best\)"
    with pytest.raises(InputError, match=rf"there is no method 'sha': did you mean 'shah'\? {known}"):
        method_of("sha")


def test_each_system_has_its_methods():
    assert [m.name for m in applicable(two_cameras(n=4)[0])] == ["opencv-stereo", "opencv-stereo-fixed"]
    arms = ["shah", "li", "tsai", "park", "horaud", "andreff", "daniilidis"]
    assert [m.name for m in applicable(arm(n=4))] == arms
    assert [m.name for m in applicable(range_pair(n=1)[0])] == ["icp", "icp-average", "icp-best"]
    assert applicable(lidar_and_camera()[0]) == []


def test_opencv_is_not_imported_before_it_is_needed():
    code = "import sys, calibration.engine.comparison; assert 'cv2' not in sys.modules and 'scipy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
