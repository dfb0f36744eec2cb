"""Launch files in XML, YAML and Python: what is read of them, and that none is run or makes the checks hang."""

import pytest

from benchmarks.ros_defects import found_in
from benchmarks.ros_defects.workspace import Workspace
from calibration.addons.analysis.ros.launch import Remapping, package_of, read_launch_xml, read_launch_yaml, resolved
from calibration.addons.analysis.ros.launch_python import read_launch_python

XML = """<launch>
  <arg name="side" default="left"/>
  <group ns="robot" unless="$(arg fake)">
    <remap from="image" to="image_raw"/>
    <node pkg="p" type="camera" name="$(arg side)_camera" ns="/top"/>
    <node pkg="p" type="lidar" name="lidar"><param name="rate" value="5"/></node>
  </group>
  <node pkg="p" type="alone" name="alone"/>
</launch>
"""
YAML = """launch:
- group:
  - push-ros-namespace:
      namespace: robot
  - node:
      pkg: p
      exec: lidar
      param:
      - name: rate
        value: 5
      remap:
      - from: scan
        to: scan_raw
"""
PYTHON = """
from launch import LaunchDescription
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
raise SystemExit("run")
def generate_launch_description():
    config = [FindPackageShare("p"), "/config/a.yaml"]
    return LaunchDescription([Node(package="p", executable="lidar", namespace="robot", name=f"l{1}",
        parameters=[config, {"rate": 5}], remappings=[("scan", "scan_raw")])])
"""


def test_scopes_of_xml() -> None:
    launch = read_launch_xml("a.launch", XML.encode())
    assert launch is not None
    camera, lidar, alone = launch.starts
    assert (camera.name, camera.namespace, camera.conditional, camera.is_named) == (None, "top", True, True)
    assert (lidar.name, lidar.namespace, [each.name for each in lidar.parameters]) == ("lidar", "robot", ["rate"])
    assert lidar.remappings == (Remapping("image", "image_raw", 4),)
    assert (alone.namespace, alone.conditional, alone.remappings) == ("", False, ())
    assert launch.arguments == {"side": True}
    assert ("fake", 3) in launch.used


def test_yaml_and_python_say_the_same() -> None:
    yaml, python = read_launch_yaml("a.launch.yaml", YAML), read_launch_python("a.launch.py", PYTHON)
    assert yaml is not None
    assert python is not None
    for start in (*yaml.starts, *python.starts):
        assert (start.package, start.executable, start.name, start.namespace) == ("p", "lidar", None, "robot")
        assert [(each.old, each.new) for each in start.remappings] == [("scan", "scan_raw")]
        assert [each.name for each in start.parameters] == ["rate"]
    assert python.starts[0].parameter_files == ("package://p/config/a.yaml",)


@pytest.mark.parametrize(
    "text",
    [
        "launch: &a\n- group: *a\n",
        "a: &a [x]\nlaunch: *a",
        "launch: [" * 5000,
        "launch:\n" + "- group:\n" * 100,
        "x: &x [1]\n" + "".join(f"x{n}: &x{n} [*x{n - 1 if n else ''}, *x]\n" for n in range(9)),
    ],
)
def test_hostile_yaml_ends(text: str) -> None:
    read_launch_yaml("a.launch.yaml", text)


def test_python_that_refers_to_itself_ends() -> None:
    text = (
        "def generate_launch_description(): pass\na = a + a\nb = [b, b]\nNode(package=a, executable=b, parameters=b)\n"
    )
    launch = read_launch_python("a.launch.py", text)
    assert launch is not None
    assert launch.starts[0].package is None


@pytest.mark.parametrize("text", ["package://p/../../etc/passwd", "package://p/$(arg x)", "package://p/*.urdf", "/a/b"])
def test_paths_that_are_of_no_package(text: str) -> None:
    assert package_of(text) is None


def test_names_are_resolved() -> None:
    assert resolved("robot", "scan") == "/robot/scan"
    assert resolved("", "scan") == "/scan"
    assert resolved("robot", "/scan") == "/scan"
    assert resolved(None, "scan") is None


def test_a_file_that_cmake_makes_is_not_missed() -> None:
    files = dict(Workspace(1, 0).files)
    [path] = [each for each in files if each.endswith("_bringup/launch/robot.launch")]
    [cmake] = [each for each in files if each.endswith("_bringup/CMakeLists.txt")]
    files[path] = files[path].replace("config/tools.yaml", "config/made.yaml")
    assert [each.rule for each in found_in(files)] == ["ros/no-such-file"]
    files[cmake] += "configure_file(tools.in config/made.yaml)\n"
    assert found_in(files) == []


def test_a_file_that_an_image_gets_is_not_missed() -> None:
    files = dict(Workspace(1, 0).files)
    [path] = [each for each in files if each.endswith("_bringup/launch/robot.launch")]
    folder = path.partition("/")[0]
    files[path] = files[path].replace("config/tools.yaml", "config/made.yaml")
    files["docker/Dockerfile"] = f"FROM ros\nCOPY made.yaml /opt/{folder}/config/made.yaml\n"
    assert found_in(files) == []
