"""Joints: the transform that URDF says, and how each parameter moves it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry import rotations
from calibration.engine.geometry.joints import JOINT_PARAMETERS, JointModel
from calibration.engine.geometry.transforms import (
    adjoint,
    from_xyz_rpy,
    inverse,
    local,
    retract,
    transform,
    translation,
    twists_in_child,
)
from tests.properties import at_most

MODELS = [JointModel(False, (0.0, 0.6, 0.8)), JointModel(True, (0.8, 0.0, -0.6)), JointModel(False, (0.0, 0.0, 1.0))]
ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7)


@pytest.mark.parametrize("model", MODELS)
@at_most(25)
@given(values=ANGLES, position=st.floats(-2, 2))
def test_a_joint_is_its_origin_and_a_motion_by_position_and_bias(model, values, position):
    values = np.array(values)
    step = (position + values[6]) * np.array(model.axis)
    motion = translation(step) if model.prismatic else transform(rotations.exp(step), np.zeros(3))
    expected = from_xyz_rpy(values[:3], values[3:6]) @ motion
    np.testing.assert_allclose(model.pose(values) @ model.motion(position), expected, atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
@at_most(25)
@given(values=ANGLES)
def test_the_columns_are_the_derivatives(model, values):
    values, h = np.array(values), 1e-6
    for k, column in enumerate(model.columns(values).T):
        ahead, behind = (local(model.pose(values), model.pose(values + s * h * np.eye(7)[k])) for s in (1, -1))
        np.testing.assert_allclose(column, (ahead - behind) / (2 * h), atol=1e-8)


def test_positions_of_any_shape():
    for model in MODELS:
        T = model.motion(np.linspace(-1, 1, 6).reshape(2, 3))
        assert T.shape == (2, 3, 4, 4)
        np.testing.assert_array_equal(T[1, 2], model.motion(1.0))


def test_units():
    turning, sliding = MODELS[:2]
    assert [turning.unit(p) for p in JOINT_PARAMETERS] == ["m"] * 3 + ["rad"] * 4
    assert [sliding.unit(p) for p in JOINT_PARAMETERS] == ["m"] * 3 + ["rad"] * 3 + ["m"]


def test_a_few_twists_are_moved_as_the_adjoint_does():
    rng = np.random.default_rng(0)
    T = retract(np.broadcast_to(np.eye(4), (5, 4, 4)), rng.normal(size=(5, 6)))
    for k in (1, 3, 7):
        columns = rng.normal(size=(6, k))
        np.testing.assert_allclose(twists_in_child(T, columns), adjoint(inverse(T)) @ columns, atol=1e-12)
