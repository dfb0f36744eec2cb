"""Kinds of defects: an edit of a workspace, the rule that names it, and the line where it is."""

import random
import re
from dataclasses import dataclass

from benchmarks.ros_defects.workspace import Files, Workspace

_WORD = re.compile(r"~(\w+)~")


@dataclass(frozen=True)
class Edit:
    """Change of one file of a workspace; ROBOT, STATUS, TOPIC stand for drawn names, ``~name~`` is misspelt."""

    version: int
    """Of ROS."""
    path: str
    old: str
    """Text that stands once in the file; all of the file if empty, which need not exist."""
    new: str | None
    """None to remove the file."""
    at: tuple[str, str] | None = None
    """File and text of the line of the finding, if it is not where the first changed line is."""


@dataclass(frozen=True)
class Kind:
    """Kind of defect."""

    name: str
    rule: str
    edits: tuple[Edit, ...]


@dataclass(frozen=True)
class Planted:
    """Workspace with a defect."""

    files: Files
    path: str
    line: int

    @property
    def place(self) -> tuple[str, int]:
        """File and line of the finding."""
        return self.path, self.line


def planted(kind: Kind, seed: int) -> Planted:
    """Return a workspace with a defect of a kind."""
    edit = kind.edits[seed % len(kind.edits)]
    workspace = Workspace(edit.version, seed)
    draw = random.Random(f"{kind.name} {seed}")
    files, path = dict(workspace.files), workspace.filled(edit.path)
    old = workspace.filled(edit.old)
    if edit.new is None:
        del files[path]
    else:
        new = _WORD.sub(lambda match: _misspelt(match[1], draw), workspace.filled(edit.new))
        text = files.get(path, "")
        if old and text.count(old) != 1:
            raise ValueError(f"{kind.name}: {path} has {old!r} {text.count(old)} times")
        files[path] = text.replace(old, new) if old else new
    if edit.at is None:
        return Planted(files, path, _first_difference(workspace.files.get(path, ""), files[path]))
    where, mark = map(workspace.filled, edit.at)
    lines = files[where].split("\n")
    return Planted(files, where, 1 + next(number for number, line in enumerate(lines) if mark in line))


def _first_difference(before: str, now: str) -> int:
    pairs = zip(before.split("\n"), now.split("\n"), strict=False)
    return next((number for number, (old, new) in enumerate(pairs, 1) if old != new), 1)


def _misspelt(word: str, draw: random.Random) -> str:
    """Return a word with a letter too few, too many, or two exchanged; the first one stays."""
    while True:
        at = draw.randrange(1, len(word) - 1)
        variants = (
            word[:at] + word[at + 1 :],
            word[:at] + word[at] + word[at:],
            word[:at] + word[at + 1] + word[at] + word[at + 2 :],
        )
        if (found := draw.choice(variants)) != word:
            return found


_BASE_CPP = "ROBOT_driver/src/base.cpp"
_DRIVER_XML, _DRIVER_CMAKE = "ROBOT_driver/package.xml", "ROBOT_driver/CMakeLists.txt"
_TOOLS_XML = "ROBOT_tools/package.xml"
_URDF = "ROBOT_description/urdf/robot.urdf"
_LAUNCH1, _LAUNCH2 = "ROBOT_bringup/launch/robot.launch", "ROBOT_bringup/launch/robot.launch.py"
_SENSORS2 = "ROBOT_bringup/launch/sensors.launch.xml"
_MONITOR1, _MONITOR2 = "ROBOT_tools/scripts/monitor.py", "ROBOT_tools/ROBOT_tools/monitor.py"
_FOLLOWER2 = "ROBOT_tools/ROBOT_tools/follower.py"
_MESH = "ROBOT_description/meshes/base.stl"
_CALIBRATION = "calibration/config.yml"
_SENSORS_INCLUDE = (_LAUNCH2, "AnyLaunchDescriptionSource(sensors)")

KINDS: tuple[Kind, ...] = (
    Kind(
        "package.xml without a version",
        "package-xml",
        (Edit(2, _DRIVER_XML, "  <version>0.3.1</version>\n", "", (_DRIVER_XML, "<package format")),),
    ),
    Kind(
        "a version of two numbers",
        "package-xml",
        (
            Edit(1, _DRIVER_XML, "1.2.0", "1.2"),
            Edit(2, _TOOLS_XML, "0.3.1", "0.3"),
        ),
    ),
    Kind(
        "run_depend in format 2",
        "package-xml",
        (Edit(1, _TOOLS_XML, "<exec_depend>rospy</exec_depend>", "<run_depend>rospy</run_depend>"),),
    ),
    Kind(
        "another name in project()",
        "package-name",
        (
            Edit(1, _DRIVER_CMAKE, "project(ROBOT_driver)", "project(ROBOT_base)"),
            Edit(2, _DRIVER_CMAKE, "project(ROBOT_driver)", "project(~ROBOT_driver~)"),
        ),
    ),
    Kind(
        "another name in setup.py",
        "package-name",
        (
            Edit(
                2,
                "ROBOT_tools/setup.py",
                "name=package_name",
                'name="~ROBOT_tools~"',
            ),
        ),
    ),
    Kind(
        "two packages of one name",
        "package-twice",
        (
            Edit(1, _TOOLS_XML, "<name>ROBOT_tools</name>", "<name>ROBOT_driver</name>"),
            Edit(2, _TOOLS_XML, "<name>ROBOT_tools</name>", "<name>ROBOT_driver</name>"),
        ),
    ),
    Kind(
        "a dependency declared twice",
        "dependency-twice",
        (
            Edit(
                1,
                _DRIVER_XML,
                "  <depend>roscpp</depend>\n",
                "  <depend>roscpp</depend>\n  <depend>roscpp</depend>\n",
            ),
        ),
    ),
    Kind(
        "a header's package that is not declared",
        "undeclared-dependency",
        (
            Edit(
                1,
                _BASE_CPP,
                "#include <ROBOT_driver/base.h>\n",
                "#include <ROBOT_driver/base.h>\n#include <nav_msgs/Path.h>\n",
            ),
            Edit(
                2,
                _BASE_CPP,
                '#include "rclcpp/rclcpp.hpp"\n',
                '#include "nav_msgs/msg/path.hpp"\n#include "rclcpp/rclcpp.hpp"\n',
            ),
        ),
    ),
    Kind(
        "an import's package that is not declared",
        "undeclared-dependency",
        (
            Edit(1, "ROBOT_tools/scripts/monitor.py", "import rospy\n", "import rospy\nimport tf2_ros\n"),
            Edit(
                2,
                "ROBOT_tools/ROBOT_tools/monitor.py",
                "import rclpy\n",
                "import rclpy\nfrom nav_msgs.msg import Path\n",
            ),
        ),
    ),
    Kind(
        "find_package of a package that is not declared",
        "undeclared-dependency",
        (
            Edit(1, _DRIVER_CMAKE, "  roscpp\n  sensor_msgs\n", "  pluginlib\n  roscpp\n  sensor_msgs\n"),
            Edit(
                2,
                _DRIVER_CMAKE,
                "find_package(rclcpp REQUIRED)",
                "find_package(nav_msgs REQUIRED)\nfind_package(rclcpp REQUIRED)",
            ),
        ),
    ),
    Kind(
        "a message's package that is not declared",
        "undeclared-dependency",
        (
            Edit(1, "ROBOT_msgs/msg/Wheel.msg", "string name\n", "string name\nsensor_msgs/JointState state\n"),
            Edit(2, "ROBOT_interfaces/msg/STATUS.msg", "float64 battery\n", "float64 battery\nsensor_msgs/Imu imu\n"),
        ),
    ),
    Kind(
        "a package of a launch file that is not declared",
        "undeclared-dependency",
        (
            Edit(
                1,
                "ROBOT_bringup/package.xml",
                "  <exec_depend>ROBOT_description</exec_depend>\n",
                "",
                ("ROBOT_bringup/launch/robot.launch", "find ROBOT_description"),
            ),
        ),
    ),
    Kind(
        "a dependency that nothing uses",
        "unused-dependency",
        (
            Edit(
                1,
                _DRIVER_XML,
                "  <depend>roscpp</depend>\n",
                "  <depend>nav_msgs</depend>\n  <depend>roscpp</depend>\n",
            ),
            Edit(
                2,
                _DRIVER_XML,
                "  <depend>rclcpp</depend>\n",
                "  <depend>nav_msgs</depend>\n  <depend>rclcpp</depend>\n",
            ),
        ),
    ),
    Kind(
        "an exported dependency that is only built with",
        "undeclared-dependency",
        (
            Edit(
                1,
                _DRIVER_XML,
                "<depend>roscpp</depend>",
                "<build_depend>roscpp</build_depend>",
                (_DRIVER_CMAKE, "CATKIN_DEPENDS"),
            ),
        ),
    ),
    Kind(
        "a Python package without setup.py",
        "build-type",
        (Edit(2, "ROBOT_tools/setup.py", "", None, (_TOOLS_XML, "<build_type>")),),
    ),
    Kind(
        "no ament_package() or catkin_package()",
        "build-type",
        (
            Edit(2, _DRIVER_CMAKE, "ament_package()\n", "", (_DRIVER_CMAKE, "project(")),
            Edit(1, "ROBOT_tools/CMakeLists.txt", "catkin_package()\n", "", ("ROBOT_tools/CMakeLists.txt", "project(")),
        ),
    ),
    Kind(
        "a target's dependency that is not found",
        "not-found-in-cmake",
        (
            Edit(
                2,
                _DRIVER_CMAKE,
                "ament_target_dependencies(scanner rclcpp",
                "ament_target_dependencies(scanner tf2_ros rclcpp",
            ),
        ),
    ),
    Kind(
        "a source file that does not exist",
        "no-such-source",
        (
            Edit(1, _DRIVER_CMAKE, "src/base.cpp", "src/~base~.cpp"),
            Edit(2, _DRIVER_CMAKE, "src/scanner.cpp", "src/~scanner~.cpp"),
        ),
    ),
    Kind(
        "an installed folder that does not exist",
        "no-such-source",
        (
            Edit(1, _DRIVER_CMAKE, "install(DIRECTORY config", "install(DIRECTORY params config"),
            Edit(2, "ROBOT_bringup/CMakeLists.txt", "install(DIRECTORY launch", "install(DIRECTORY ~launch~"),
        ),
    ),
    Kind(
        "an installed target that is not built",
        "no-such-target",
        (
            Edit(1, _DRIVER_CMAKE, "install(TARGETS ${PROJECT_NAME}", "install(TARGETS ${PROJECT_NAME}_core"),
            Edit(2, _DRIVER_CMAKE, "install(TARGETS base scanner", "install(TARGETS base ~scanner~"),
        ),
    ),
    Kind(
        "a generated interface that does not exist",
        "no-such-interface",
        (
            Edit(1, "ROBOT_msgs/CMakeLists.txt", "Wheel.msg", "~Wheel~.msg"),
            Edit(2, "ROBOT_interfaces/CMakeLists.txt", "srv/SetMode.srv", "srv/~SetMode~.srv"),
        ),
    ),
    Kind(
        "an interface that is not generated",
        "interface-not-built",
        (
            Edit(1, "ROBOT_msgs/msg/Led.msg", "", "bool on\n"),
            Edit(2, "ROBOT_interfaces/msg/Led.msg", "", "bool is_on\n"),
        ),
    ),
    Kind(
        "a field of an unknown type",
        "interface-field",
        (
            Edit(1, "ROBOT_msgs/msg/STATUS.msg", "Wheel[] wheels", "~Wheel~[] wheels"),
            Edit(2, "ROBOT_interfaces/msg/STATUS.msg", "float64 battery", "~float64~ battery"),
        ),
    ),
    Kind(
        "a field's name that ROS 2 refuses",
        "interface-field",
        (Edit(2, "ROBOT_interfaces/msg/STATUS.msg", "float64 battery", "float64 batteryLevel"),),
    ),
    Kind(
        "an entry point of a module that does not exist",
        "no-such-entry-point",
        (Edit(2, "ROBOT_tools/setup.py", "ROBOT_tools.follower:main", "ROBOT_tools.~follower~:main"),),
    ),
    Kind(
        "an entry point of a function that does not exist",
        "no-such-entry-point",
        (Edit(2, "ROBOT_tools/setup.py", "ROBOT_tools.monitor:main", "ROBOT_tools.monitor:~main~"),),
    ),
    Kind(
        "an executable that does not exist",
        "no-such-executable",
        (
            Edit(1, _LAUNCH1, 'type="base_node"', 'type="~base_node~"'),
            Edit(2, _LAUNCH2, 'executable="follower"', 'executable="~follower~"'),
            Edit(2, _SENSORS2, 'exec="scanner"', 'exec="~scanner~"'),
        ),
    ),
    Kind(
        "an included launch file that does not exist",
        "no-such-file",
        (
            Edit(1, _LAUNCH1, "launch/sensors.launch", "launch/~sensors~.launch"),
            Edit(2, _LAUNCH2, '"sensors.launch.xml"', '"~sensors~.launch.xml"'),
            Edit(2, "ROBOT_bringup/launch/all.launch.yaml", "robot.launch.py", "~robot~.launch.py"),
        ),
    ),
    Kind(
        "a file of parameters that does not exist",
        "no-such-file",
        (
            Edit(1, _LAUNCH1, "config/tools.yaml", "config/~tools~.yaml"),
            Edit(2, _SENSORS2, "config/driver.yaml", "config/~driver~.yaml"),
            Edit(2, _LAUNCH2, '"config", "tools.yaml"', '"config", "~tools~.yaml"'),
        ),
    ),
    Kind(
        "a mesh that does not exist",
        "no-such-file",
        (Edit(1, _URDF, "meshes/base.stl", "meshes/~base~.stl"), Edit(2, _URDF, "meshes/base.stl", "mesh/base.stl")),
    ),
    Kind(
        "a file that is not installed",
        "not-installed",
        (
            Edit(1, "ROBOT_description/CMakeLists.txt", "launch meshes urdf", "launch urdf", (_URDF, "base.stl")),
            Edit(
                2, "ROBOT_description/CMakeLists.txt", "launch meshes urdf", "meshes urdf", (_LAUNCH2, "description =")
            ),
            Edit(
                2,
                "ROBOT_driver/CMakeLists.txt",
                "install(DIRECTORY config DESTINATION share/${PROJECT_NAME})\n",
                "",
                (_SENSORS2, "param from"),
            ),
        ),
    ),
    Kind(
        "an argument that an included file does not declare",
        "launch-argument",
        (
            Edit(1, _LAUNCH1, '<arg name="frame" value', '<arg name="~frame~" value'),
            Edit(2, _LAUNCH2, '{"frame": "laser_link"}', '{"~frame~": "laser_link"}'),
        ),
    ),
    Kind(
        "an argument that an included file needs",
        "launch-argument",
        (
            Edit(1, _LAUNCH1, '    <arg name="frame" value="laser_link"/>\n', "", (_LAUNCH1, "sensors.launch")),
            Edit(
                2,
                _SENSORS2,
                '  <arg name="frame"/>\n',
                '  <arg name="frame"/>\n  <arg name="side"/>\n',
                _SENSORS_INCLUDE,
            ),
        ),
    ),
    Kind(
        "an argument that is not declared",
        "launch-argument",
        (
            Edit(1, "ROBOT_bringup/launch/sensors.launch", "$(arg frame)", "$(arg ~frame~)"),
            Edit(2, _SENSORS2, "$(var frame)", "$(var ~frame~)"),
            Edit(2, _LAUNCH2, 'LaunchConfiguration("mode")', 'LaunchConfiguration("~mode~")'),
        ),
    ),
    Kind(
        "a launch file that includes itself",
        "launch-cycle",
        (
            Edit(
                1,
                "ROBOT_bringup/launch/sensors.launch",
                '  <arg name="frame"/>\n',
                '  <arg name="frame"/>\n  <include file="$(find ROBOT_bringup)/launch/robot.launch"/>\n',
            ),
            Edit(
                2,
                _SENSORS2,
                '  <arg name="frame"/>\n',
                '  <arg name="frame"/>\n  <include file="$(find-pkg-share ROBOT_bringup)/launch/all.launch.yaml"/>\n',
            ),
        ),
    ),
    Kind(
        "two nodes of one name",
        "node-name-twice",
        (
            Edit(1, _LAUNCH1, 'name="monitor"', 'name="follower"'),
            Edit(2, _LAUNCH2, 'name="monitor"', 'name="follower"', (_LAUNCH2, 'executable="monitor"')),
        ),
    ),
    Kind(
        "a topic of two types",
        "topic-types",
        (
            Edit(
                1,
                _MONITOR1,
                "from ROBOT_msgs.msg import STATUS\n",
                "from ROBOT_msgs.msg import Wheel as STATUS\n",
                (_MONITOR1, "rospy.Subscriber"),
            ),
            Edit(
                2,
                _BASE_CPP,
                "create_subscription<geometry_msgs::msg::Twist>",
                "create_subscription<geometry_msgs::msg::Pose>",
            ),
            Edit(2, _FOLLOWER2, "LaserScan\n\n", "PointCloud2 as LaserScan\n\n", (_FOLLOWER2, "create_subscription")),
        ),
    ),
    Kind(
        "a service of two types",
        "topic-types",
        (
            Edit(
                1, _MONITOR1, "srv import SetMode", "srv import Trigger as SetMode", (_MONITOR1, "rospy.ServiceProxy")
            ),
            Edit(2, _MONITOR2, "srv import SetMode", "srv import Trigger as SetMode", (_MONITOR2, "create_client")),
        ),
    ),
    Kind(
        "a subscriber of a misspelt topic",
        "not-connected",
        (
            Edit(1, _MONITOR1, '"TOPIC_status"', '"~TOPIC_status~"'),
            Edit(2, _MONITOR2, '"TOPIC_status"', '"~TOPIC_status~"'),
            Edit(1, _BASE_CPP, '"cmd_vel"', '"~cmd_vel~"'),
            Edit(2, _BASE_CPP, '"cmd_vel"', '"~cmd_vel~"', (_BASE_CPP, "create_subscription")),
        ),
    ),
    Kind(
        "a remapping to a misspelt topic",
        "not-connected",
        (
            Edit(1, _LAUNCH1, 'to="TOPIC_scan_raw"', 'to="~TOPIC_scan_raw~"'),
            Edit(2, _LAUNCH2, '"TOPIC_scan_raw")', '"~TOPIC_scan_raw~")'),
        ),
    ),
    Kind(
        "a client of a misspelt service",
        "not-connected",
        (
            Edit(1, _MONITOR1, 'ServiceProxy("set_mode"', 'ServiceProxy("~set_mode~"'),
            Edit(2, _MONITOR2, '"set_mode"', '"~set_mode~"'),
        ),
    ),
    Kind("a client of a misspelt action", "not-connected", (Edit(2, _MONITOR2, '"dock"', '"~dock~"'),)),
    Kind(
        "a reliable subscriber of a best effort publisher",
        "quality-of-service",
        (
            Edit(2, _FOLLOWER2, "BEST_EFFORT", "RELIABLE", (_FOLLOWER2, "create_subscription")),
            Edit(2, _FOLLOWER2, "self.on_scan, quality", "self.on_scan, 10"),
            Edit(
                2,
                _FOLLOWER2,
                'self.create_publisher(Twist, "cmd_vel", 1)',
                'self.create_publisher(Twist, "cmd_vel", quality)',
                (_BASE_CPP, "create_subscription"),
            ),
        ),
    ),
    Kind(
        "a transient local subscriber of a volatile publisher",
        "quality-of-service",
        (
            Edit(
                2,
                _FOLLOWER2,
                "depth=5, ",
                "depth=5, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL, ",
                (_FOLLOWER2, "create_subscription"),
            ),
        ),
    ),
    Kind(
        "a parameter that the node does not know",
        "no-such-parameter",
        (
            Edit(1, _LAUNCH1, 'param name="mode"', 'param name="~mode~"'),
            Edit(2, _LAUNCH2, '{"gain": 0.3}', '{"~gain~": 0.3}'),
            Edit(2, _SENSORS2, 'param name="frame_id"', 'param name="~frame_id~"'),
        ),
    ),
    Kind(
        "a parameter in a file that the node does not know",
        "no-such-parameter",
        (
            Edit(1, "ROBOT_bringup/config/tools.yaml", "gain", "~gain~"),
            Edit(2, "ROBOT_driver/config/driver.yaml", "wheel_radius", "~wheel_radius~"),
        ),
    ),
    Kind(
        "a remapping of a name that the node does not use",
        "unused-remapping",
        (
            Edit(1, _LAUNCH1, 'from="TOPIC_scan"', 'from="~TOPIC_scan~"'),
            Edit(2, _SENSORS2, 'from="TOPIC_scan"', 'from="~TOPIC_scan~"'),
            Edit(2, _LAUNCH2, '("TOPIC_scan"', '("~TOPIC_scan~"'),
        ),
    ),
    Kind(
        "a frame that the description does not have",
        "no-such-frame",
        (
            Edit(1, _CALIBRATION, "    link: laser_link\n", "    link: ~laser_link~\n"),
            Edit(2, _CALIBRATION, "    child_link: laser_link\n", "    child_link: scanner\n"),
        ),
    ),
    Kind(
        "a frame that the description has renamed",
        "no-such-frame",
        tuple(
            Edit(
                version,
                _URDF,
                '<link name="camera_optical"/>',
                '<link name="camera_eye"/>',
                (_CALIBRATION, "link: camera_opt"),
            )
            for version in (1, 2)
        ),
    ),
    Kind(
        "another parent of a frame",
        "frame-parent",
        (
            Edit(
                1,
                _CALIBRATION,
                "parent_link: base_link\n    child_link: camera_link",
                "parent_link: laser_link\n    child_link: camera_link",
            ),
        ),
    ),
    Kind(
        "a calibration's topic that nothing publishes",
        "not-connected",
        tuple(Edit(version, _CALIBRATION, "/TOPIC_scan_raw", "/~TOPIC_scan_raw~") for version in (1, 2)),
    ),
    Kind(
        "a mesh in millimetres",
        "mesh-size",
        (
            Edit(1, _URDF, 'base.stl"/>', 'base.stl" scale="1000 1000 1000"/>'),
            Edit(2, _MESH, "vertex 1 0 0", "vertex 1000 0 0", (_URDF, "base.stl")),
        ),
    ),
)
"""All kinds, in the order of the rules."""
