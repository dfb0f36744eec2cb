import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.base.errors import InputError
from calibration.engine.geometry import transforms
from calibration.robot.simulation.robot import compose, parse_robot, read_robot

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
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
            broken('<child link="tip"/>', '<child link="tip"/><mimic joint="gone"/>'),
            "robot.urdf: joint 'spin': follows 'gone' by <mimic>, expected a joint that moves",
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
