from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.engine.geometry.transforms import distance, from_xyz_rpy, inverse, local
from calibration.robot.simulation.kinematics import _linearise, _merged_chain, joints_between, reach, stream
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose, parse_robot


def test_an_arm_reaches_where_it_has_been(systems: dict[str, System]) -> None:
    robot = systems["riwbot"].robot
    names = [joint.name for joint in joints_between(robot, "base_link", "flange")]
    assert names == [f"{n}_joint" for n in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
    q = np.random.default_rng(0).uniform(-2, 2, (200, 6))
    targets = compose(robot.tree, robot.transforms(dict(zip(names, q.T, strict=True))), "base_link", "flange")
    positions, reached = reach(robot, "base_link", "flange", targets, stream(0))
    assert reached.mean() > 0.5
    T = compose(robot.tree, robot.transforms(positions), "base_link", "flange")
    translation, angle = distance(T[reached], targets[reached])
    assert translation.max() < 1e-7
    assert angle.max() < 1e-7


def test_upwards_through_the_joints_too(systems: dict[str, System]) -> None:
    robot = systems["riwbot"].robot
    targets = compose(robot.tree, robot.transforms({"elbow_joint": np.linspace(1, 2, 30)}), "base_link", "flange")
    positions, reached = reach(robot, "flange", "base_link", inverse(targets), stream(1))
    assert reached.mean() > 0.5
    T = compose(robot.tree, robot.transforms(positions), "flange", "base_link")
    assert distance(T[reached], inverse(targets)[reached])[0].max() < 1e-7


def test_unreachable_targets_are_reported(systems: dict[str, System]) -> None:
    _, reached = reach(
        systems["riwbot"].robot, "base_link", "flange", from_xyz_rpy([[5.0, 0, 0]] * 4, [[0.0, 0, 0]] * 4), stream(0)
    )
    assert not reached.any()


def test_no_joint_between_frames_of_a_tripod(systems: dict[str, System]) -> None:
    assert joints_between(systems["t2rgb"].robot, "tripod", "camera_left_link") == []


def test_what_is_reached_is_within_the_limits(systems: dict[str, System]) -> None:
    robot = systems["riwbot"].robot
    narrow = replace(
        robot,
        joints=tuple(replace(j, lower=-1.0, upper=1.5) if j.name == "elbow_joint" else j for j in robot.joints),
    )
    names = [joint.name for joint in joints_between(robot, "base_link", "flange")]
    q = dict(zip(names, np.random.default_rng(1).uniform(-2, 2, (6, 300)), strict=True))
    targets = compose(robot.tree, robot.transforms(q), "base_link", "flange")
    positions, reached = reach(narrow, "base_link", "flange", targets, stream(0))
    assert 0 < reached.mean() < 0.7
    narrow.transforms({name: values[reached] for name, values in positions.items()})  # raises outside the limits
    outside = (positions["elbow_joint"] < -1) | (positions["elbow_joint"] > 1.5)
    assert outside.any()
    assert not (outside & reached).any()


def test_one_target_does_not_change_what_another_one_gets(systems: dict[str, System]) -> None:
    robot = systems["riwbot"].robot
    targets = compose(robot.tree, robot.transforms({"elbow_joint": np.linspace(1, 2, 8)}), "base_link", "flange")
    far = targets.copy()
    far[4:, :3, 3] += 9.0
    alone, mixed = (reach(robot, "base_link", "flange", T, stream(3))[0] for T in (targets, far))
    for name in alone:
        np.testing.assert_array_equal(alone[name][:4], mixed[name][:4])


def test_a_slide_and_a_hinge(tmp_path: Path) -> None:
    links = "".join(f'<link name="{name}"/>' for name in "abc")
    robot = parse_robot(
        f"""<robot name="r">{links}
        <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><origin rpy="0 0 0.4"/>
          <axis xyz="1 0 0"/><limit lower="0" upper="2"/></joint>
        <joint name="hinge" type="continuous"><parent link="b"/><child link="c"/><origin xyz="0 0 0.3"/>
          <axis xyz="0 1 0"/></joint></robot>""".encode(),
        tmp_path / "robot.urdf",
    )
    slide, hinge = np.linspace(0.1, 1.9, 20), np.linspace(-3, 3, 20)
    targets = compose(robot.tree, robot.transforms({"slide": slide, "hinge": hinge}), "a", "c")
    positions, reached = reach(robot, "a", "c", targets, stream(5))
    assert reached.mean() > 0.8
    np.testing.assert_allclose(positions["slide"][reached], slide[reached], atol=1e-8)
    np.testing.assert_allclose(positions["hinge"][reached], hinge[reached], atol=1e-8)


def test_a_joint_that_mimics_another_one_moves_with_it(tmp_path: Path) -> None:
    links = "".join(f'<link name="{name}"/>' for name in "abcd")
    robot = parse_robot(
        f"""<robot name="r">{links}
        <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
          <limit lower="0" upper="2"/></joint>
        <joint name="upper" type="prismatic"><parent link="b"/><child link="c"/><origin rpy="0 0 0.4"/>
          <axis xyz="1 0 0"/><mimic joint="slide" multiplier="0.5" offset="0.1"/></joint>
        <joint name="hinge" type="continuous"><parent link="c"/><child link="d"/><origin xyz="0 0 0.3"/>
          <axis xyz="0 1 0"/></joint></robot>""".encode(),
        tmp_path / "robot.urdf",
    )
    assert [joint.name for joint in joints_between(robot, "d", "a")] == ["hinge", "slide"]
    q, step = np.array([[0.7, 0.4]]), 1e-6
    way, index = _merged_chain(robot, "a", "d"), {"slide": 0, "hinge": 1}
    here = compose(robot.tree, robot.transforms({"slide": q[:, 0], "hinge": q[:, 1]}), "a", "d")
    moved = compose(robot.tree, robot.transforms({"slide": q[:, 0] + step, "hinge": q[:, 1]}), "a", "d")
    _, J = _linearise(way, here, q, index)
    np.testing.assert_allclose(J[0, :, 0], local(here, moved)[0] / step, atol=1e-6)
    given = {"slide": np.linspace(0.1, 1.9, 20), "hinge": np.linspace(-3, 3, 20)}
    for start, end in (("a", "d"), ("d", "a")):
        targets = compose(robot.tree, robot.transforms(given), start, end)
        positions, reached = reach(robot, start, end, targets, stream(5))
        assert reached.mean() > 0.8
        for name, values in given.items():
            np.testing.assert_allclose(positions[name][reached], values[reached], atol=1e-8)
