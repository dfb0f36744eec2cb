"""Robot descriptions made of macros: expanded as a team's are, and kept from doing harm."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.robot import robot_description
from calibration.robot.exports import exported
from calibration.robot.importing.importing import import_data
from calibration.robot.robot_description import XacroInputs, read_robot_description
from calibration.robot.simulation.system import read_system
from calibration.robot.urdf import parse_robot
from tests.robot.importing.arm import ON_FLANGE, SYSTEM, keys, record_arm
from tests.robot.importing.test_bags import describe, file_of

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
    found = parse_robot(read_robot_description(file, XacroInputs(packages=tmp_path)), file)
    assert [joint.name for joint in found.joints] == [
        joint.name for joint in parse_robot((SYSTEM / "robot.urdf").read_bytes(), file).joints
    ]


def test_its_own_package_comes_before_one_of_the_same_name(tmp_path: Path) -> None:
    file = package(
        tmp_path / "mine", "arm", "arm.urdf.xacro", f'{HEAD}<xacro:include filename="$(find arm)/a.xacro"/></robot>'
    )
    for folder in ("mine", "other"):
        (tmp_path / folder / "arm").mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "arm" / "a.xacro").write_text(f'{HEAD}<link name="{folder}"/></robot>')
    shutil.copy(tmp_path / "mine" / "arm" / "package.xml", tmp_path / "other" / "arm")
    assert b"mine" in read_robot_description(file, XacroInputs(packages=tmp_path / "other"))


def test_a_copied_package_without_its_package_xml_is_found_by_its_folder(tmp_path: Path) -> None:
    file = tmp_path / "third_party" / "arm_description" / "robots" / "arm.urdf.xacro"
    (file.parent / "parts").mkdir(parents=True)
    file.write_text(f'{HEAD}<xacro:include filename="$(find arm_description)/robots/parts/a.xacro"/></robot>')
    (file.parent / "parts" / "a.xacro").write_text(f'{HEAD}<link name="copied"/></robot>')
    assert b"copied" in read_robot_description(file, XacroInputs(packages=tmp_path / "third_party"))


def test_a_xacro_by_another_name_is_expanded(tmp_path: Path) -> None:
    """As TurtleBot3's, whose launch file calls xacro on a .urdf."""
    file = tmp_path / "robot.urdf"
    file.write_text(f'{HEAD}<xacro:arg name="ns" default="left_"/><link name="$(arg ns)base"/></robot>')
    assert b"left_base" in read_robot_description(file)
    assert b"right_base" in read_robot_description(file, XacroInputs(xacro={"ns": "right_"}))


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
        read_robot_description(SYSTEM / "robot.urdf", XacroInputs(packages=tmp_path / "nowhere"))


ARGUED = f"""{HEAD.replace("it", "$(arg name)", 1)}
<xacro:arg name="name"{{default}}/><xacro:arg name="size" default="2"/><xacro:arg name="unused"/>
<link name="a"/><link name="b"/>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="${{{{$(arg size) / 2}}}} 0 0"/></joint>
</robot>"""
"""A xacro whose own name is an argument, as that of a UR is."""


def test_arguments_are_given_by_name(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(ARGUED.format(default=""))
    found = parse_robot(read_robot_description(file, XacroInputs({"name": "ur5e", "size": "5"})), file)
    assert found.name == "ur5e"
    assert found.joints[0].T_parent_joint[0, 3] == 2.5
    file.write_text(ARGUED.format(default=' default="own"'))
    assert parse_robot(read_robot_description(file), file).name == "own"


def test_a_file_of_another_argument_is_named_with_what_was_given(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(
        f'{HEAD}<xacro:arg name="model" default="none"/><xacro:include filename="$(arg model).xacro"/></robot>'
    )
    with pytest.raises(InputError, match=r"no file .*none\.xacro.*the key xacro.*model=none"):
        read_robot_description(file)
    (tmp_path / "arm.xacro").write_text(f"{HEAD}<link name='${{1 + 1}}'/></robot>")
    assert b'name="2"' in read_robot_description(file, XacroInputs({"model": "arm"}))


def test_arguments_stand_where_a_description_does(tmp_path: Path) -> None:
    xacro = tmp_path / "robot.urdf.xacro"
    urdf = (SYSTEM / "robot.urdf").read_text()
    at = urdf.index("<robot")
    xacro.write_text(
        urdf[at:]
        .replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
        .replace('name="riwbot"', 'name="$(arg name)"')
    )
    for name in ("config.yml", "simulation.yml"):
        shutil.copy(SYSTEM / name, tmp_path)
    with pytest.raises(InputError, match="its argument 'name' has no value"):
        read_system(tmp_path)
    with (tmp_path / "simulation.yml").open("a") as simulation:
        simulation.write("\nxacro: {name: true}\n")
    assert read_system(tmp_path).robot.name == "true"
    path = file_of(tmp_path, "db3")
    record_arm(path, "db3", keys()[:8], urdf=False)
    bags = {"robot-description": "robot.urdf.xacro", "xacro": {"name": 5}}
    described = describe(path, patterns={"board": ON_FLANGE}, bags=bags)
    assert import_data(described, tmp_path / "out", jobs=1).collections == 8
    dataset = calibrate(read_dataset(SYSTEM)).dataset
    made, _ = exported(dataset, ["urdf"], xacro, XacroInputs({"name": "it"}))
    assert b'name="it"' in made["calibrated.urdf"]


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
    assert b'"left_link"' in read_robot_description(file, XacroInputs({"prefix": "left_"}))


@pytest.mark.parametrize("declared", ["", '<xacro:arg name="ur_type"/>'])
def test_an_argument_that_nobody_gives_is_named_with_its_key(tmp_path: Path, declared: str) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f'{HEAD}{declared}<link name="$(arg ur_type)"/></robot>')
    with pytest.raises(InputError, match=r"its argument 'ur_type' has no value: .*xacro: \{ur_type: \.\.\.\}"):
        read_robot_description(file)


def test_a_urdf_has_no_arguments() -> None:
    with pytest.raises(InputError, match="found the xacro argument 'prefix'"):
        read_robot_description(SYSTEM / "robot.urdf", XacroInputs({"prefix": "left_"}))
