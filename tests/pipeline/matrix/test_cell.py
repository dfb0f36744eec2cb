"""What a cell's own results say of a calibration."""

import numpy as np
import pytest

from calibration.comparison.methods import applicable, method_of
from calibration.errors import InputError
from calibration.estimation.calibrate import calibrate
from calibration.pipeline.matrix import cell as cells
from tests.estimation.systems import jointed_arm
from tests.pipeline.matrix.test_judgement import CELL


def test_joints_are_told_with_their_sigmas() -> None:
    scene = jointed_arm(free={"j2": ("position_bias",), "j3": ("origin_yaw",)}, pixel_noise=0.2)
    calibration = calibrate(scene.dataset())
    found = cells._described(CELL, calibration).details["joints"]
    told = [(each["name"], each["parameter"], each["unit"]) for each in found]
    asked = [(joint.name, parameter) for joint in calibration.joints.values() for parameter in joint.parameters]
    assert [each[:2] for each in told] == asked
    assert {each[2] for each in told} <= {"m", "rad"}
    assert calibration.converged
    values = np.concatenate([joint.values for joint in calibration.joints.values()])
    assert [each["value"] for each in found] == values.tolist()
    assert all(0 < each["sigma"] < 1 for each in found)


def test_other_methods_calibrate_no_joints() -> None:
    dataset = jointed_arm().dataset()
    assert applicable(dataset) == []
    with pytest.raises(InputError, match=r"^Shah calibrates no joints, and the dataset asks for j3$"):
        method_of("shah").calibrate(dataset)
