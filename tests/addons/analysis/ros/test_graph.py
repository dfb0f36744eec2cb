"""The graph of nodes: names after namespaces and remappings, what is not resolved, what a change connects and cuts."""

import json
from pathlib import Path

import pytest
from defusedxml.ElementTree import fromstring

from benchmarks.ros_defects import found_in
from benchmarks.ros_defects.workspace import Files, Workspace, write
from calibration.addons.analysis.analysers.own_checks import RosGraph, read_graph
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.ros.client_code import Quality, read_cpp, read_python
from calibration.addons.analysis.ros.graph import Graph, build_graphs
from calibration.addons.analysis.ros.launch_checks import parameters_of, private_parameters_of
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import Tree


def graph_of(folder: Path, files: Files) -> Graph:
    write(folder, files)
    [graph] = build_graphs(RosRepository(Tree(folder, files)))
    return graph


def read(folder: Path, files: Files) -> RosGraph:
    write(folder, files)
    return read_graph(Copy(folder, tuple(files), present=tuple(files)), 60)


def robot(version: int, change: tuple[str, str] = ("", "")) -> Files:
    """Return a workspace, with a text that is replaced in the launch file at the top."""
    files = Workspace(version, 0).files
    end = "robot.launch" if version == 1 else "robot.launch.py"
    return {path: text.replace(*change) if path.endswith(end) and change[0] else text for path, text in files.items()}


@pytest.mark.parametrize("version", [1, 2])
def test_both_versions_of_the_robot_have_one_graph(version: int, tmp_path: Path) -> None:
    graph = graph_of(tmp_path, robot(version))
    [scan] = {each.name for each in graph.of("publisher") if "scan" in each.name}
    assert scan.endswith("_scan_raw")
    assert {each.node for each in graph.of("publisher", "subscriber") if each.name == scan} == {"/scanner", "/follower"}
    assert [(each.name, each.node) for each in graph.of("server")] == [("/set_mode", "/base")]
    assert graph.unresolved == ()


@pytest.mark.parametrize(
    ("version", "change"),
    [
        (1, ('name="base" output="screen"', 'name="base" ns="arm"')),
        (2, ('name="base", parameters', 'name="base", namespace="arm", parameters')),
    ],
)
def test_a_namespace_cuts_what_was_connected(version: int, change: tuple[str, str], tmp_path: Path) -> None:
    before, now = read(tmp_path / "before", robot(version)), read(tmp_path / "now", robot(version, change))
    changed = now.since(before)
    assert "/cmd_vel: /follower -> /base" in changed.cut
    assert changed.connected == ()
    assert before.since(None).cut == ()


def test_what_is_known_only_at_run_time_is_named_and_no_finding(tmp_path: Path) -> None:
    files = {path: text.replace('Twist, "cmd_vel", 1', "Twist, TOPIC, 1") for path, text in robot(2).items()}
    graph = graph_of(tmp_path / "topic", files)
    assert [each.rpartition(": ")[2] for each in graph.unresolved] == ["the name of a publisher"]
    assert found_in(files) == []
    files = robot(2, ('remappings=[("', 'remappings=[(PREFIX + "'))
    graph = graph_of(tmp_path / "remapping", files)
    assert [each.rpartition(" ")[2] for each in graph.unresolved] == ["publisher", "subscriber"]
    assert found_in(files) == []


def test_the_document_and_the_picture_are_valid(tmp_path: Path) -> None:
    files = {path: text.replace("cmd_vel", "a&amp;<b>") for path, text in robot(2).items()}
    graph = read(tmp_path, files)
    [document] = json.loads(graph.document)["graphs"]
    assert document["launch"].endswith("all.launch.yaml")
    assert document["topics"]["/a&amp;<b>"] == {
        "types": ["geometry_msgs/Twist"],
        "from": ["/follower"],
        "to": ["/base"],
    }
    texts = [each.text for each in fromstring(graph.picture).iter("{http://www.w3.org/2000/svg}text")]
    assert "/a&amp;<b>" in texts


def test_qualities_of_service() -> None:
    source = """
from rclpy.qos import QoSProfile, ReliabilityPolicy, DurabilityPolicy, qos_profile_sensor_data
from std_msgs.msg import String
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, "a", 10)
node.create_publisher(String, "b", qos_profile_sensor_data)
node.create_publisher(String, "c", latched)
node.create_publisher(String, "d", QoSProfile(depth=1, reliability=chosen))
node.create_publisher(String, "e", given)
"""
    assert [each.quality for each in read_python("a.py", source).calls] == [
        Quality(),
        Quality("best effort"),
        Quality("reliable", "transient local"),
        None,
        None,
    ]


def test_calls_of_cpp() -> None:
    source = """#include <ros/ros.h>
namespace {{ const std::string kTopic{{"left"}}; }}
void Driver::onImage(const boost::shared_ptr<sensor_msgs::Image const>& image) {{}}
void f() {{
  ros::NodeHandle pnh("~"), other("arm");
  ros::NodeHandle arm("arm");
  auto a = pnh.advertise<std_msgs::String>(kTopic, 1);
  auto b = nh_.subscribe("image", 1, &Driver::onImage, this);
  auto c = arm.advertise<std_msgs::String>("x", 1);
  auto d = nh_.advertise<std_msgs::String>(prefix + "y", 1);
}}
""".format()
    found = [(each.kind, each.name, each.type) for each in read_cpp("a.cpp", source).calls]
    assert found == [
        ("publisher", "~left", "std_msgs/String"),
        ("subscriber", "image", "sensor_msgs/Image"),
        ("publisher", None, "std_msgs/String"),
        ("publisher", None, "std_msgs/String"),
    ]


def test_files_of_parameters() -> None:
    text = (
        "/**: {ros__parameters: {a: 1}}\nlidar:\n  ros__parameters:\n    b: {c: 2}\nother: {ros__parameters: {d: 1}}\n"
    )
    assert [(each.name, each.line) for each in parameters_of("p.yaml", text, "/robot/lidar")] == [("a", 1), ("b.c", 4)]
    assert [each.name for each in private_parameters_of("p.yaml", "a: 1\nb: {c: 2}\n")] == ["a", "b/c"]
    assert private_parameters_of("p.yaml", "a: &a {b: *a}\n") == []
    assert parameters_of("p.yaml", "{", "/x") == []


@pytest.mark.parametrize("description", ["robot.urdf", "../calibration/robot.urdf"])
def test_a_description_beside_the_configuration_is_read(description: str) -> None:
    files = robot(2)
    [urdf] = [text for path, text in files.items() if path.endswith("robot.urdf")]
    configuration = files["calibration/config.yml"].replace("link: laser_link", "link: lidar_link", 1)
    [named] = [line for line in configuration.splitlines() if line.startswith("description_file")]
    files["calibration/config.yml"] = configuration.replace(named, f"description_file: {description}")
    files["calibration/robot.urdf"] = urdf
    assert [(each.path, each.rule) for each in found_in(files)] == [("calibration/config.yml", "ros/no-such-frame")]


def test_the_frames_of_a_dataset_are_checked() -> None:
    files = robot(2)
    [description] = [path for path in files if path.endswith("_description/package.xml")]
    name = description.split("/")[-2]
    sensor = {"link": "lidar_link", "parent_link": "base_link", "child_link": "laser_link", "topic_name": "/x"}
    configuration = {"description_file": f"package://{name}/urdf/robot.urdf", "sensors": {"laser": sensor}}
    files["data/dataset.json"] = json.dumps({"calibration_config": configuration}, indent=1)
    [finding] = found_in(files)
    assert (finding.path, finding.rule) == ("data/dataset.json", "ros/no-such-frame")
    assert "lidar_link" in files["data/dataset.json"].split("\n")[finding.line - 1]
    for text in (
        "[]",
        '{"calibration_config": 1, "description_file": "sensors"}',
        "{",
        '{"sensors": "description_file"}',
    ):
        files["data/dataset.json"] = text
        assert found_in(files) == []
