"""Robot descriptions made of macros: expanded as a team's are, and kept from doing harm."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from calibration import robot_description
from calibration.dataset.reading import read_dataset
from calibration.errors import InputError
from calibration.estimation.calibrate import calibrate
from calibration.exports.files import exported
from calibration.importing.importing import import_data
from calibration.robot_description import read_robot_description
from calibration.simulation.robot import parse_robot
from calibration.simulation.system import read_system
from tests.importing.arm import ON_FLANGE, SYSTEM, keys, record_arm
from tests.importing.test_bags import describe, file_of

HEAD = '<robot name="it" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def package(folder: Path, name: str, file: str, text: str) -> Path:
    """Write a file of a ROS package."""
    (folder / name / "urdf").mkdir(parents=True)
    (folder / name / "package.xml").write_text(f"<package><name>{name}</name><version>1.0.0</version></package>")
    (folder / name / "urdf" / file).write_text(text)
    return folder / name / "urdf" / file


def arm_in_packages(folder: Path) -> Path:
    """riwbot's description as a macro of one package, which a file of another one calls."""
    urdf = (SYSTEM / "robot.urdf").read_text()
    body = urdf[urdf.index(">", urdf.index("<robot")) + 1 : urdf.rindex("</robot>")]
    package(folder, "arm_description", "arm.xacro", f'{HEAD}<xacro:macro name="arm">{body}</xacro:macro></robot>')
    call = '<xacro:include filename="$(find arm_description)/urdf/arm.xacro"/><xacro:arm/></robot>'
    return package(folder, "cell_description", "cell.urdf.xacro", HEAD + call)


def test_joints_of_a_xacro_move_a_camera(tmp_path: Path) -> None:
    path = file_of(tmp_path, "db3")
    record_arm(path, "db3", keys()[:8], urdf=False)
    arm_in_packages(tmp_path / "src")
    bags = {"robot-description": "src/cell_description/urdf/cell.urdf.xacro", "packages": "src"}
    results = import_data(describe(path, patterns={"board": ON_FLANGE}, bags=bags), tmp_path / "out", jobs=1)
    assert results.collections == 8
    assert read_dataset(tmp_path / "out").patterns["board"].fixed


def test_it_expands_to_the_same_robot(tmp_path: Path) -> None:
    file = arm_in_packages(tmp_path)
    found = parse_robot(read_robot_description(file, tmp_path), file)
    assert [joint.name for joint in found.joints] == [
        joint.name for joint in parse_robot((SYSTEM / "robot.urdf").read_bytes(), file).joints
    ]


def test_a_system_of_a_simulation_may_have_one(tmp_path: Path) -> None:
    folder = tmp_path / "cell_description" / "urdf"
    arm_in_packages(tmp_path).rename(folder / "robot.urdf.xacro")
    for name in ("config.yml", "simulation.yml"):
        shutil.copy(SYSTEM / name, folder)
    found, expected = read_system(folder), read_system(SYSTEM)
    assert [joint.name for joint in found.robot.joints] == [joint.name for joint in expected.robot.joints]
    assert b"macro" not in found.sources["robot.urdf"]
    assert read_system(SYSTEM, robot=folder / "robot.urdf.xacro").sources == found.sources


def test_exports_write_the_expanded_robot(tmp_path: Path) -> None:
    dataset = calibrate(read_dataset(SYSTEM)).dataset
    made, _ = exported(dataset, ["urdf"], arm_in_packages(tmp_path))
    expected, _ = exported(dataset, ["urdf"], SYSTEM / "robot.urdf")
    ours, theirs = (parse_robot(files["calibrated.urdf"], SYSTEM) for files in (made, expected))
    assert [joint.name for joint in ours.joints] == [joint.name for joint in theirs.joints]
    for edge, T in theirs.transforms({}).items():
        np.testing.assert_allclose(ours.transforms({})[edge], T, atol=1e-15)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            '<xacro:include filename="$(find nowhere)/a.xacro"/>',
            "nowhere.*looked for beside the file's own one and in its repository",
        ),
        ("<link name='${1 / 0}'/>", "division by zero"),
        ("<link name='${undefined}'/>", "undefined"),
        ("<link", "not well-formed|no element found|unclosed token"),
        ("<link name='$(env SECRET)'/>", "SECRET"),
    ],
)
def test_what_cannot_be_expanded_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, message: str
) -> None:
    monkeypatch.setenv("SECRET", "hush")
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f"{HEAD}{body}</robot>")
    with pytest.raises(InputError, match=message) as error:
        read_robot_description(file)
    assert "hush" not in str(error.value)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(f"{file}: this xacro cannot be expanded: ")


def test_an_endless_one_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_description, "SECONDS", 2)
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f"{HEAD}<link name='${{sum(1 for _ in range(10**12))}}'/><link name='${{10**(10**9)}}'/></robot>")
    with pytest.raises(InputError, match="cannot be expanded"):
        read_robot_description(file)


def test_a_folder_of_packages_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such folder, expected one with the packages"):
        read_robot_description(SYSTEM / "robot.urdf", tmp_path / "nowhere")


LANGUAGE = {
    "${pi / 2 + -1.5 * 2 ** 3}": str(np.pi / 2 - 12),
    "${radians(180) == pi and not False}": "True",
    "${sin(0) + math.cos(0) + math.hypot(3, 4)}": "6.0",
    "${limits['elbow']['upper']}": str(np.radians(90)),
    "${limits.elbow.axis[1] + limits.elbow.axis[-1]}": "1",
    "${' '.join(str(x * 2) for x in limits.elbow.axis if x)}": "2",
    "${[a + b for a, b in python.zip([1, 2], [3, 4])]}": "[4, 6]",
    "${len(limits) if 'elbow' in limits.keys() else 0}": "1",
    "${python.sorted(limits.elbow.items())[0][0].upper()}": "AXIS",
    "${limits.get('wrist', 'none')}": "none",
    "${'%.2f_%s' % (1 / 3, prefix)}": "0.33_left_",
    "${prefix + 'arm'}": "left_arm",
    "${prefix.strip('_').replace('l', 'r')[::-1]}": "tfer",
    "${xacro.tokenize('1 2,3')[2]}": "3",
    "${dict(a=1, b=[2])['b'][0]}": "2",
    "${0 < 1 <= 1 != 2}": "True",
    "${max(1, 2, *[3]) // 2 % 2 | 4}": "5",
    "${list(map(float, '1 2'.split()))}": "[1.0, 2.0]",
    "${round(2.5678, 2) + int('3') if prefix else 0}": "5.57",
    "${python.abs(-1) + python.sum([1, 2])}": "4",
    "${xacro.arg('side')}$(arg side)": "leftleft",
    "$(eval side == 'left')": "True",
    "$(optenv NOTHING given)": "given",
}


@pytest.mark.parametrize("expression", LANGUAGE)
def test_expressions_of_real_robots(tmp_path: Path, expression: str) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "limits.yaml").write_text("elbow: {upper: !degrees 90, axis: [0, 1, 0]}")
    (tmp_path / "config" / "sides.xacro").write_text(
        f'{HEAD}<xacro:property name="prefix" value="$(arg side)_"/></robot>'
    )
    (tmp_path / "robot.urdf.xacro").write_text(
        f'{HEAD}<xacro:arg name="side" default="left"/><xacro:include filename="config/sides.xacro"/>'
        """<xacro:property name="limits" value="${xacro.load_yaml('config/limits.yaml')}"/>"""
        f"<link>{expression.replace('<', '&lt;')}</link></robot>"
    )
    expanded = read_robot_description(tmp_path / "robot.urdf.xacro")
    assert f"<link>{LANGUAGE[expression]}</link>".encode() in expanded


def test_a_file_of_the_same_repository_is_included_and_one_above_is_not(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "common.xacro").write_text(f'{HEAD}<link name="common"/></robot>')
    file = tmp_path / "arm" / "robot.urdf.xacro"
    file.write_text(f'{HEAD}<xacro:include filename="../common.xacro"/></robot>')
    with pytest.raises(InputError, match=r"common\.xacro is outside of the folders"):
        read_robot_description(file)
    (tmp_path / ".git").mkdir()
    assert b'"common"' in read_robot_description(file)


@pytest.mark.parametrize("default", ["", ' default="unused"'])
def test_arguments_have_the_values_that_are_given(tmp_path: Path, default: str) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f'{HEAD}<xacro:arg name="prefix"{default}/><link name="$(arg prefix)link"/></robot>')
    assert b'"left_link"' in read_robot_description(file, arguments={"prefix": "left_"})


@pytest.mark.parametrize("declared", ["", '<xacro:arg name="ur_type"/>'])
def test_an_argument_that_nobody_gives_is_named_with_its_key(tmp_path: Path, declared: str) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f'{HEAD}{declared}<link name="$(arg ur_type)"/></robot>')
    with pytest.raises(InputError, match=r"its argument 'ur_type' has no value: .*xacro: \{ur_type: \.\.\.\}"):
        read_robot_description(file)


def test_a_urdf_has_no_arguments() -> None:
    with pytest.raises(InputError, match="found the xacro argument 'prefix'"):
        read_robot_description(SYSTEM / "robot.urdf", arguments={"prefix": "left_"})
