import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.base import InputError
from calibration.base.records import Place, read_as
from calibration.engine.geometry import transforms
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.system import System, read_system
from calibration.robot.urdf import (
    Joint,
    JointErrors,
    JointKind,
    check_calibrated_joints,
    compose,
    parse_robot,
    read_robot,
    with_errors,
)
from tests.lint.documents import yaml_blocks
from tests.robot.simulation.conftest import DATASETS

FILE = Path("robot.urdf")

ARM = """
<robot name="arm">
  <link name="base"/><link name="turned"/><link name="slid"/><link name="tip"/>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="turned"/>
    <origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><axis xyz="0 3 4"/><limit lower="-1" upper="2"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="turned"/><child link="slid"/><axis xyz="0 0 -2"/><limit lower="0.1" upper="0.5"/>
  </joint>
  <joint name="spin" type="continuous"><parent link="slid"/><child link="tip"/></joint>
</robot>
"""


def pose(xyz: tuple[float, ...], rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


def random_chain(random: np.random.Generator) -> str:
    """A robot with joints of every kind in a row, at random origins about random axes."""
    kinds = ["revolute", "prismatic", "continuous", "fixed", "revolute", "prismatic"]
    text = '<robot name="chain"><link name="l0"/>'
    for i, kind in enumerate(kinds):
        xyz, rpy, axis = (" ".join(f"{value:.6f}" for value in random.normal(size=3)) for _ in range(3))
        unit = np.array(axis.split(), float)
        axis = " ".join(repr(float(value)) for value in unit / np.linalg.norm(unit))
        text += (
            f'<link name="l{i + 1}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-1" upper="2" effort="1" velocity="1"/></joint>'
        )
    return text + "</robot>"


@pytest.mark.parametrize("source", ["riwbot", "rlbot", "t2rgb", "chain 1", "chain 2", "chain 3"])
def test_another_library_finds_every_frame_at_the_same_place(source: str, tmp_path: Path) -> None:
    random = np.random.default_rng(len(source) + ord(source[-1]))
    path = DATASETS / source / "robot.urdf"
    if not path.exists():
        path = tmp_path / "robot.urdf"
        path.write_text(random_chain(random))
    robot = read_robot(path)
    import yourdfpy  # slow to import, for every worker that collects the tests

    other = yourdfpy.URDF.load(path, load_meshes=False, build_scene_graph=True)
    assert set(other.actuated_joint_names) == set(robot.movable)
    for _ in range(5):
        positions = {
            name: random.uniform(max(joint.lower, -3), min(joint.upper, 3)) for name, joint in robot.movable.items()
        }
        other.update_cfg(positions)
        found = robot.transforms({name: np.array([value]) for name, value in positions.items()})
        for frame in robot.tree.frames:
            T = compose(robot.tree, found, other.base_link, frame)[0]
            np.testing.assert_allclose(T, other.get_transform(frame, other.base_link), atol=1e-12)


def test_each_kind_of_joint_moves_as_urdf_says() -> None:
    robot = parse_robot(ARM.encode(), FILE)
    positions = {"turn": np.array([0.0, 0.7]), "slide": np.array([0.2, 0.4]), "spin": np.array([0.0, 9.0])}
    T = robot.transforms(positions)
    for i in range(2):
        turn = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]) * Rotation.from_rotvec(
            positions["turn"][i] * np.array([0, 0.6, 0.8])
        )
        np.testing.assert_allclose(T["base", "turned"][i], pose((1, 2, 3), turn), atol=1e-12)
        np.testing.assert_allclose(T["turned", "slid"][i], pose((0, 0, -positions["slide"][i]), Rotation.identity()))
        spin = Rotation.from_rotvec([positions["spin"][i], 0, 0])
        np.testing.assert_allclose(T["slid", "tip"][i], pose((0, 0, 0), spin), atol=1e-12)


def test_ur10e_agrees_with_its_published_kinematics() -> None:
    """The flange of a UR10e by its Denavit-Hartenberg parameters, which the manufacturer publishes."""
    robot = read_robot(DATASETS / "riwbot" / "robot.urdf")
    d, a, alpha = (
        (0.1807, 0, 0, 0.17415, 0.11985, 0.11655),
        (0, -0.6127, -0.57155, 0, 0, 0),
        (math.pi / 2, 0, 0, math.pi / 2, -math.pi / 2, 0),
    )
    q = np.random.default_rng(0).uniform(-3, 3, (20, 6))
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    T = compose(
        robot.tree,
        robot.transforms({f"{name}_joint": q[:, i] for i, name in enumerate(names)}),
        "base_link_inertia",
        "wrist_3_link",
    )
    for i in range(len(q)):
        expected = np.eye(4)
        for j in range(6):
            expected = (
                expected
                @ pose((0, 0, d[j]), Rotation.from_rotvec([0, 0, q[i, j]]))
                @ pose((a[j], 0, 0), Rotation.from_rotvec([alpha[j], 0, 0]))
            )
        np.testing.assert_allclose(T[i], expected, atol=1e-9)


def test_riwbot_chain_by_hand() -> None:
    robot = read_robot(DATASETS / "riwbot" / "robot.urdf")
    T = compose(robot.tree, robot.transforms({}), "world", "base_link")[0]
    expected = (
        pose((-1, 0, 0), Rotation.from_euler("z", math.pi / 2))
        @ pose((0, 0, 0.795), Rotation.identity())
        @ pose((0, 0.25, 0.001), Rotation.identity())
    )
    np.testing.assert_allclose(T, expected, atol=1e-12)
    # REP 103: a flange's x axis points out of it, along the z axis of the last wrist
    flange = compose(robot.tree, robot.transforms({}), "wrist_3_link", "flange")[0]
    np.testing.assert_allclose(flange[:3, 0], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_shipped_robots_equal_the_shared_ones(name: str, shared_data: Path) -> None:
    ours = read_robot(DATASETS / name / "robot.urdf")
    theirs = read_robot(shared_data / "synthetic" / name / "robot.urdf")
    a, b = ours.transforms({}), theirs.transforms({})
    assert a.keys() == b.keys()
    for edge, T in a.items():
        translation, angle = transforms.distance(T, b[edge])
        assert translation[0] < 1e-9, edge
        assert angle[0] < 1e-7, edge


def test_a_joint_that_is_not_named_rests() -> None:
    robot = parse_robot(ARM.encode(), FILE)
    T = robot.transforms({}, count=3)
    assert T["turned", "slid"].shape == (3, 4, 4)
    assert T["turned", "slid"][0, 2, 3] == -0.1  # 0 is below its lower limit


def test_mimic_joints_follow() -> None:
    """A chain of two: tip2 follows tip1, which follows the turn."""
    urdf = ARM.replace(
        "</robot>",
        """<link name="tip1"/><link name="tip2"/>
        <joint name="first" type="revolute"><parent link="tip"/><child link="tip1"/>
          <mimic joint="turn" multiplier="-2" offset="0.1"/></joint>
        <joint name="second" type="prismatic"><parent link="tip"/><child link="tip2"/>
          <mimic joint="first" multiplier="0.5" offset="0.01"/></joint></robot>""",
    )
    robot = parse_robot(urdf.encode(), FILE)
    assert list(robot.movable) == ["turn", "slide", "spin"]
    T = robot.transforms({"turn": np.array([0.0, 0.3])})
    angles = [rotation.as_rotvec()[0] for rotation in Rotation.from_matrix(T["tip", "tip1"][:, :3, :3])]
    np.testing.assert_allclose(angles, [0.1, -0.5])
    np.testing.assert_allclose(T["tip", "tip2"][:, 0, 3], [0.06, -0.24])
    with pytest.raises(InputError, match="'first' follows another joint"):
        robot.transforms({"first": np.zeros(2)})


def test_a_joint_that_follows_nothing_stays_at_its_origin() -> None:
    """As the fingers of a published hand, whose names were changed and not those in <mimic>."""
    urdf = broken('<child link="tip"/>', '<child link="tip"/><mimic joint="gone"/>')
    robot = parse_robot(urdf.encode(), FILE)
    assert list(robot.movable) == ["turn", "slide"]
    np.testing.assert_array_equal(robot.transforms({}, count=2)["slid", "tip"], np.stack([np.eye(4)] * 2))
    with pytest.raises(InputError, match="'spin' follows 'gone'"):
        robot.transforms({"spin": np.zeros(2)})


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_without_an_axis_stay_at_their_origin(kind: str) -> None:
    robot = parse_robot(ARM.replace("continuous", kind).encode(), FILE)
    assert list(robot.movable) == ["turn", "slide"]
    np.testing.assert_array_equal(robot.transforms({}, count=2)["slid", "tip"], np.stack([np.eye(4)] * 2))


def test_a_joint_without_limits_is_read() -> None:
    robot = parse_robot(ARM.replace('<limit lower="-1" upper="2"/>', "").encode(), FILE)
    assert robot.transforms({"turn": np.array([9.0])})


def broken(old: str, new: str) -> str:
    assert old in ARM
    return ARM.replace(old, new)


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        ("hello", "robot.urdf: is not XML: syntax error: line 1, column 0"),
        ("<robot>", "robot.urdf: is not XML: no element found: line 1, column 7"),
        ("<sdf/>", "robot.urdf: the root element is <sdf>, not <robot>"),
        ("<robot name='r'><link name='a'/></robot>", "robot.urdf: there is no joint"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "robot.urdf: has a DTD or entities; a robot description needs none"),
        ('<?xml version="1.0" encoding="nonsense"?><robot/>', "robot.urdf: is not XML: unknown encoding: nonsense"),
        (
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="a"/></robot>',
            "robot.urdf: is a xacro; name it robot.urdf.xacro and it is expanded",
        ),
        (broken('name="turn" ', ""), "robot.urdf: a joint has no name"),
        (broken('<parent link="slid"/>', ""), "robot.urdf: joint 'spin': has no parent link"),
        (broken('<child link="tip"/>', "<child/>"), "robot.urdf: joint 'spin': has no child link"),
        (broken('<link name="tip"/>', ""), "robot.urdf: joint 'spin': the child link 'tip' is not in the robot"),
        (
            broken('type="continuous"', 'type="helical"'),
            "robot.urdf: joint 'spin': type 'helical' is not supported (supported: fixed, revolute, continuous, prism",
        ),
        (
            broken('<child link="tip"/>', '<child link="tip"/><mimic joint="spin"/>'),
            "robot.urdf: joint 'spin': follows itself by <mimic>",
        ),
        (
            broken('<child link="tip"/>', '<child link="tip"/><mimic joint="turn" multiplier="x"/>'),
            "robot.urdf: joint 'spin': mimic: multiplier is 'x', expected a finite number",
        ),
        (
            broken('<child link="tip"/>', '<child link="turned"/>'),
            "robot.urdf: joint 'spin': link 'turned' has two parents, 'base' by joint 'turn' and 'slid'",
        ),
        (
            broken('<parent link="base"/>', '<parent link="tip"/>'),
            "robot.urdf: frames form a loop: tip -> turned -> slid -> tip",
        ),
        (
            broken('<link name="base"/>', '<link name="base"/><link name="other"/>').replace(
                '<parent link="slid"/>', '<parent link="other"/>'
            ),
            "robot.urdf: the links are not one tree: 'base', 'other' have no parent",
        ),
        (broken('name="spin"', 'name="turn"'), "robot.urdf: joint 'turn': two joints have this name"),
        (broken("0 3 4", "0 0 0"), "robot.urdf: joint 'turn': axis xyz has length 0"),
        (broken("0 3 4", "0 3"), "robot.urdf: joint 'turn': axis: xyz is '0 3', expected 3 finite numbers"),
        (broken("1 2 3", "1 nan 3"), "robot.urdf: joint 'turn': origin: xyz is '1 nan 3', expected 3 finite numbers"),
        (broken('lower="-1"', 'lower="x"'), "robot.urdf: joint 'turn': limit: lower is 'x', expected a finite number"),
        (broken('lower="-1"', 'lower="3"'), "robot.urdf: joint 'turn': limit lower 3 is above upper 2"),
        (
            broken('name="spin"', 'name="sp&#10;in"').replace("continuous", "odd"),
            "robot.urdf: joint 'sp\\nin': type 'odd' is not supported (supported: fixed, revolute",
        ),
    ],
)
def test_errors_are_one_line(urdf: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        parse_robot(urdf.encode(), FILE)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def test_a_missing_or_huge_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing.urdf: .* cannot be read: No such file"):
        read_robot(tmp_path / "nothing.urdf")
    huge = tmp_path / "huge.urdf"
    huge.write_bytes(b" " * 10_000_001)
    with pytest.raises(InputError, match=r"huge.urdf: found 10000001 bytes"):
        read_robot(huge)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ({"elbow": [0.0]}, "joint 'elbow' is not in the robot (joints that move: turn, slide, spin)"),
        ({"turn": [0.0, 2.5]}, "joint 'turn' at 2.5 in pose 2 is outside its limits -1 to 2"),
        ({"spin": [math.nan]}, "joint 'spin' at nan in pose 1 is outside its limits -inf to inf"),
    ],
)
def test_positions_that_a_joint_cannot_have(positions: dict[str, list[float]], message: str) -> None:
    robot = parse_robot(ARM.encode(), FILE)
    with pytest.raises(InputError) as error:
        robot.transforms({name: np.array(values) for name, values in positions.items()})
    assert str(error.value) == f"robot.urdf: {message}"


def test_a_fixed_joint_has_no_position() -> None:
    robot = read_robot(DATASETS / "t2rgb" / "robot.urdf")
    with pytest.raises(
        InputError, match=r"joint 'world_to_tripod' is fixed and has no position \(joints that move: none"
    ):
        robot.transforms({"world_to_tripod": np.zeros(1)})


SMALL = st.floats(-0.5, 0.5)


def joint(kind: JointKind = "revolute", xyz: tuple[float, ...] = (0.1, 0.2, 0.3)) -> Joint:
    return Joint("j", kind, "a", "b", from_xyz_rpy(xyz, (0.4, -0.5, 0.6)), np.array([0.0, 0.6, 0.8]), -2.0, 2.0)


@given(st.sampled_from(["revolute", "continuous", "prismatic"]), st.lists(SMALL, min_size=7, max_size=7), SMALL)
def test_errors_of_the_origin_and_of_the_position(kind: JointKind, errors: list[float], position: float) -> None:
    """The bias is as if the joint stood further on; the origin's parameters add up as ATOM's do."""
    nominal = joint(kind)
    robot = replace(read_system(DATASETS / "spjbot").nominal, joints=(nominal,))
    own = dict(zip(JOINT_PARAMETERS, errors, strict=True))
    (true,) = with_errors(robot, {"j": own}).joints
    expected = replace(
        nominal,
        T_parent_joint=from_xyz_rpy(
            np.array([0.1, 0.2, 0.3]) + errors[:3], np.array([0.4, -0.5, 0.6]) + np.array(errors[3:6])
        ),
    )
    np.testing.assert_allclose(
        true.transform(np.array([position])), expected.transform(np.array([position + errors[6]])), atol=1e-12
    )
    np.testing.assert_allclose(nominal.values(own), np.add([0.1, 0.2, 0.3, 0.4, -0.5, 0.6, 0], errors))
    np.testing.assert_allclose(nominal.model.pose(nominal.values()), nominal.T_parent_joint, atol=1e-12)


def test_what_the_docs_show_is_read() -> None:
    """One block is of config.yml, the other of simulation.yml; both speak of the same two joints."""
    docs = Path(__file__).parents[3] / "docs" / "joints.md"
    asked, simulated = (yaml.safe_load(text) for _, text in yaml_blocks(docs.read_text()))
    elbow, slide = replace(joint(), name="elbow"), replace(joint("prismatic"), name="slide")
    robot = replace(read_system(DATASETS / "spjbot").nominal, joints=(elbow, slide))
    parameters = {name: tuple(each["params_to_calibrate"]) for name, each in asked["joints"].items()}

    check_calibrated_joints(parameters, robot, "config.yml")
    errors = read_as(JointErrors, simulated["joints"], Place("docs"))
    assert {name: tuple(own) for name, own in errors.items()} == parameters


def test_the_description_stays_as_it_is(systems: dict[str, System]) -> None:
    system = systems["spjbot"]
    assert system.joint_errors == {
        "j2_joint": {"origin_yaw": 0.02},
        "j3_joint": {"origin_z": 0.005},
        "j4_joint": {"origin_yaw": -0.015},
    }
    changed = [
        name
        for name, j in system.nominal.movable.items()
        if (j.transform(0) != system.robot.movable[name].transform(0)).any()
    ]
    assert changed == list(system.joint_errors)
    assert all(systems[name].robot is systems[name].nominal for name in ("t2rgb", "rlbot", "riwbot", "softbot"))


def read(folder: Path, errors: object) -> JointErrors:
    """The errors of spjbot's joints, of a copy in which they are these."""
    for name in ("robot.urdf", "config.yml"):
        shutil.copy(DATASETS / "spjbot" / name, folder)
    simulation = yaml.safe_load((DATASETS / "spjbot" / "simulation.yml").read_text())
    (folder / "simulation.yml").write_text(yaml.safe_dump(simulation | {"joints": errors}))
    return read_system(folder).joint_errors


def test_errors_are_read(systems: dict[str, System], tmp_path: Path) -> None:
    assert read(tmp_path, None) == {}
    found = read(tmp_path, {"j5_joint": {"position_bias": -0.1, "origin_x": 0}, "j1_joint": {}})
    assert found == {"j5_joint": {"position_bias": -0.1}, "j1_joint": {}}
    assert with_errors(systems["spjbot"].nominal, {"j1_joint": {}}) is systems["spjbot"].nominal


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({"j9": {}}, r"joints: unknown key 'j9'.*known: j1_joint, .*j5_joint"),
        ({"world_to_base_link": {}}, "unknown key 'world_to_base_link'"),
        ({"j1_joint": {"yaw": 1}}, r"joints.j1_joint: unknown key 'yaw'.*known: origin_x, .*position_bias"),
        ({"j1_joint": {"origin_z": 1.5}}, "origin_z: found 1.5, expected a number from -1 to 1"),
        ({"j1_joint": {"origin_z": float("nan")}}, "origin_z: found nan"),
        ({"j1_joint": {"origin_z": "far"}}, "origin_z: found 'far'"),
        ({"j1_joint": 0.1}, r"joints\.j1_joint: found 0.1, expected keys"),
        ([0.1], "joints"),
    ],
)
def test_invalid_joint_errors_are_refused(tmp_path: Path, errors: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, errors)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ("j9: {params_to_calibrate: [origin_x]}", "joints/j9: .*robot.urdf has no joint 'j9' that moves .*j1_joint"),
        ("world_to_base_link: {params_to_calibrate: [origin_x]}", "no joint 'world_to_base_link' that moves"),
        (
            "j1_joint: {params_to_calibrate: [origin_x, yaw]}",
            "joints/j1_joint/params_to_calibrate: found 'yaw', expected one or more of origin_x, ",
        ),
        ("j1_joint: {params_to_calibrate: []}", "joints/j1_joint/params_to_calibrate: found no parameter"),
    ],
)
def test_joints_that_cannot_be_calibrated(tmp_path: Path, joints: str, message: str) -> None:
    text = (DATASETS / "spjbot" / "config.yml").read_text()
    config = tmp_path / "config.yml"
    config.write_text(text.replace("joints:\n", f"joints:\n  {joints}\n"))
    with pytest.raises(InputError, match=message):
        read_system(DATASETS / "spjbot", configuration=config)


def test_a_transform_is_calibrated_once(tmp_path: Path) -> None:
    text = (DATASETS / "softbot" / "config.yml").read_text()
    config = tmp_path / "config.yml"
    config.write_text(text.replace("joints:\n", "joints:\n  turn: {params_to_calibrate: [origin_yaw]}\n"))
    with pytest.raises(InputError, match="joints/turn: the whole transform from 'odometry_y' to 'base_footprint'"):
        read_system(DATASETS / "softbot", configuration=config)
