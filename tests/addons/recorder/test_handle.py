from dataclasses import replace

import numpy as np
import pytest

from calibration.addons.recorder.session import Session, drag, find_handle, handle_pose
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, translation
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.system import System


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_the_handle_is_on_the_middle_of_the_pattern(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    session, handle = Session(system), find_handle(system)
    (pattern,) = system.patterns.values()
    assert handle is not None
    middle = np.append(pattern.outline.mean(axis=0), 0.0)
    in_world = apply(session.placement.patterns[pattern.name][0], middle[None])[0]
    np.testing.assert_allclose(handle_pose(system, handle, session.pose)[:3, 3], in_world, atol=1e-9)


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_a_dragged_handle_goes_where_it_is_dragged(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    session, handle = Session(system), find_handle(system)
    assert handle is not None
    target = handle_pose(system, handle, session.pose) @ from_xyz_rpy([0.03, -0.02, 0.04], [0.1, 0.05, -0.1])
    pose = drag(system, handle, session.pose, target)
    assert pose is not None
    np.testing.assert_allclose(handle_pose(system, handle, pose), target, atol=2e-6)


def test_an_arm_that_is_dragged_a_little_turns_its_joints_a_little(systems: dict[str, System]) -> None:
    system = systems["riwbot"]
    session, handle = Session(system), find_handle(system)
    assert handle is not None
    # Every joint a whole turn on: its limits are two turns wide, and a step must not unwind it
    start = {name: q + 2 * np.pi * (q < 0) for name, q in session.pose.joints.items() if name != "elbow_joint"}
    before = replace(session.pose, joints={**session.pose.joints, **start})
    place(system, before)  # inside the limits
    after = drag(system, handle, before, handle_pose(system, handle, before) @ translation([0.002, 0.0, 0.0]))
    assert after is not None
    assert max(abs(float(after.joints[name][0] - q[0])) for name, q in before.joints.items()) < 0.1


def test_what_an_arm_does_not_reach_is_none(systems: dict[str, System]) -> None:
    system = systems["riwbot"]
    session, handle = Session(system), find_handle(system)
    assert handle is not None
    far = translation([5.0, 0.0, 0.0]) @ handle_pose(system, handle, session.pose)
    assert drag(system, handle, session.pose, far) is None


def test_with_a_fixed_pattern_the_sensor_that_moves_is_held(rail: System) -> None:
    handle = find_handle(rail)
    assert handle is not None
    assert handle.frame == "optical"
    session = Session(rail, Motion(None, None, {"slide": np.array([0.1])}))
    there = translation([0.25, 0.0, 0.0]) @ handle_pose(rail, handle, session.pose)
    pose = drag(rail, handle, session.pose, there)
    assert pose is not None
    assert pose.joints["slide"][0] == pytest.approx(session.pose.joints["slide"][0] + 0.25, abs=1e-6)
    assert drag(rail, handle, session.pose, translation([0.0, 0.0, 0.1]) @ there) is None  # the rail does not rise
