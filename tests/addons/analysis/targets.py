"""Files of others that static analysis reads, fuzzed by `tests.campaigns`."""

import json
import re
from pathlib import Path

from benchmarks.ros_defects.workspace import Workspace
from calibration.addons.analysis.report import FINGERPRINT, read_earlier
from calibration.addons.analysis.ros.__main__ import check as check_ros
from calibration.addons.analysis.ros.client_code import read_cpp, read_python
from calibration.addons.analysis.ros.launch import read_launch_xml, read_launch_yaml
from calibration.addons.analysis.ros.launch_python import read_launch_python
from calibration.addons.analysis.ros.tree import Tree
from calibration.addons.analysis.settings import read_suppressions
from tests.campaigns.target import Target

SUPPRESSIONS = b"""\
suppressions:
- {rule: ruff/S603, path: "scripts/*", reason: only names of our own, until: 2030-01-31}
- {rule: "lizard/*", reason: generated}
"""


def _workspaces() -> list[bytes]:
    """Repositories of ROS packages, all files of each one after the other, below their paths."""
    return [
        b"".join(b"=== %s\n%s\n" % (path.encode(), text.encode()) for path, text in Workspace(version, 1).files.items())
        for version in (1, 2)
    ]


def _packages(path: Path) -> None:
    _, *parts = re.split(rb"^=== ([\w./]{1,80})\n", path.read_bytes(), flags=re.MULTILINE)
    known = {name for version in (1, 2) for name in Workspace(version, 1).files}
    files = {name.decode(): text for name, text in zip(parts[::2], parts[1::2], strict=True) if name.decode() in known}
    for name, text in files.items():
        (path.parent / name).parent.mkdir(parents=True, exist_ok=True)
        (path.parent / name).write_bytes(text)
    check_ros(Tree(path.parent, files))


SARIF = {
    "version": "2.1.0",
    "runs": [
        {
            "tool": {"driver": {"name": "x", "rules": []}},
            "results": [
                {
                    "ruleId": f"ruff/F{line}",
                    "level": "error",
                    "message": {"text": "m"},
                    "locations": [
                        {
                            "physicalLocation": {
                                "artifactLocation": {"uri": "a%20b.py"},
                                "region": {"startLine": line},
                            }
                        }
                    ],
                    "partialFingerprints": {FINGERPRINT: "abc"},
                }
                for line in (1, 2)
            ],
        }
    ],
}
LAUNCH = b"""\
<launch><arg name="a" default="b"/><group ns="x"><node pkg="p" type="t" name="n"><remap from="/a" to="/b"/>
<param name="q" value="$(arg a)"/><rosparam file="$(find p)/c.yaml"/></node></group>
<include file="$(find p)/launch/b.launch"><arg name="z" value="1"/></include></launch>
"""
LAUNCH_YAML = b"""\
launch:
- arg: {name: a, default: b}
- node: {pkg: p, exec: t, name: n, namespace: x, remap: [{from: /a, to: /b}], param: [{name: q, value: 1}]}
- group:
  - push-ros-namespace: {namespace: y}
  - include: {file: $(find-pkg-share p)/b.yaml, arg: [{name: z, value: 2}]}
"""
LAUNCH_PYTHON = b"""\
from launch import LaunchDescription
from launch_ros.actions import Node
from launch.actions import IncludeLaunchDescription, DeclareLaunchArgument
def generate_launch_description():
    name = 'n' + str(1)
    nodes = [Node(package='p', executable=f'e{i}', name=name, namespace='x', remappings=[('a', 'b')],
                  parameters=[{'q': 1}], arguments=['--x', str(i)]) for i in range(3)]
    return LaunchDescription([DeclareLaunchArgument('a', default_value='b'), *nodes,
                              IncludeLaunchDescription('f', launch_arguments={'z': '1'}.items())])
"""
NODE_PYTHON = b"""\
import rospy
from std_msgs.msg import String
class N(object):
    def __init__(self):
        self.t = rospy.get_param('~topic', '/a')
        self.p = rospy.Publisher(self.t, String, queue_size=1)
        self.s = rospy.Subscriber('b', String, self.cb)
        rospy.Service('~s', Empty, lambda r: None)
        for i in range(3): rospy.Publisher('x%d' % i, String)
def main():
    rospy.init_node('n')
"""
NODE_CPP = b"""\
#include <ros/ros.h>
#include "p/M.h"
int main(int c, char** v) { ros::init(c, v, "n"); ros::NodeHandle n("~");
auto p = n.advertise<std_msgs::String>("a", 1); auto s = n.subscribe("b", 1, cb); n.getParam("q", x);
auto q = this->create_publisher<std_msgs::msg::String>("t", rclcpp::QoS(1).reliable()); return 0; }
"""


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "replace")


TARGETS = {
    "sarif": Target("earlier.sarif", lambda: [json.dumps(SARIF).encode()], read_earlier),
    "launch-xml": Target("a.launch", lambda: [LAUNCH], lambda path: read_launch_xml("a.launch", path.read_bytes())),
    "launch-yaml": Target("a.yaml", lambda: [LAUNCH_YAML], lambda path: read_launch_yaml("a.yaml", _text(path)), 4),
    "launch-python": Target("a.py", lambda: [LAUNCH_PYTHON], lambda path: read_launch_python("a.py", _text(path))),
    "ros-python": Target("a.py", lambda: [NODE_PYTHON], lambda path: read_python("a.py", _text(path))),
    "ros-cpp": Target("a.cpp", lambda: [NODE_CPP], lambda path: read_cpp("a.cpp", _text(path))),
    "ros-packages": Target("workspace", _workspaces, _packages, 4),
    "suppressions": Target(".static-analysis.yml", lambda: [SUPPRESSIONS], read_suppressions, 4),
}
"""By name."""
