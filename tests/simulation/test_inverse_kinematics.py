import numpy as np

from calibration.geometry.transforms import distance, from_xyz_rpy, inverse
from calibration.simulation.inverse_kinematics import joints_between, reach
from calibration.simulation.random_streams import stream
from calibration.simulation.robot import compose
from calibration.simulation.system import System


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


def test_what_is_out_of_reach_is_said(systems: dict[str, System]) -> None:
    _, reached = reach(
        systems["riwbot"].robot, "base_link", "flange", from_xyz_rpy([[5.0, 0, 0]] * 4, [[0.0, 0, 0]] * 4), stream(0)
    )
    assert not reached.any()


def test_no_joint_between_frames_of_a_tripod(systems: dict[str, System]) -> None:
    assert joints_between(systems["t2rgb"].robot, "tripod", "camera_left_link") == []
