"""Packages that the files of a package use: in CMake, code, interfaces, launch files and robot descriptions."""

import ast
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from calibration.addons.analysis.ros.package import Package, fields_of
from calibration.addons.analysis.ros.tree import CPP_SUFFIXES, imported_modules, parse_python, without_comments

_PACKAGE_NAMES = """
actionlib actionlib_msgs amcl ament_cmake ament_cmake_auto ament_cmake_gtest ament_cmake_pytest
ament_cmake_python ament_cmake_ros ament_index_cpp ament_lint_auto ament_lint_common angles ar_track_alvar
bond bondcpp bondpy camera_calibration camera_calibration_parsers camera_info_manager catkin class_loader
control_msgs control_toolbox controller_interface controller_manager controller_manager_msgs costmap_2d
cv_bridge depth_image_proc diagnostic_aggregator diagnostic_msgs diagnostic_updater diff_drive_controller
dynamic_reconfigure eigen_conversions eigen_stl_containers filters gazebo_msgs gazebo_plugins gazebo_ros
gazebo_ros_control gencpp genmsg genpy geographic_msgs geometric_shapes geometry_msgs gmapping
hardware_interface image_geometry image_proc image_publisher image_rotate image_transport image_view
interactive_markers joint_limits_interface joint_state_controller joint_state_publisher
joint_state_publisher_gui joint_trajectory_controller joy kdl_conversions kdl_parser kdl_parser_py
laser_assembler laser_filters laser_geometry launch_ros lifecycle_msgs map_msgs map_server message_filters
message_generation message_runtime move_base move_base_msgs moveit_commander moveit_core moveit_msgs
moveit_ros_planning moveit_ros_planning_interface nav2_bringup nav2_common nav2_costmap_2d nav2_msgs nav2_util
nav_core nav_msgs navfn nodelet nodelet_topic_tools object_recognition_msgs octomap_msgs octomap_ros
pcl_conversions pcl_msgs pcl_ros pluginlib pointcloud_to_laserscan position_controllers random_numbers rclcpp
rclcpp_action rclcpp_components rclcpp_lifecycle rclpy realtime_tools resource_retriever robot_localization
robot_state_publisher rosbag rosbag2_cpp rosbag_storage rosbridge_server roscpp rosgraph rosgraph_msgs
rosidl_default_generators rosidl_default_runtime roslaunch roslib rosmsg rosnode rosparam rospy rosservice
rostest rostopic rqt_gui rqt_gui_cpp rqt_gui_py rqt_image_view rviz rviz2 rviz_common rviz_default_plugins
sensor_msgs sensor_msgs_py shape_msgs slam_toolbox smach smach_ros sound_play srdfdom std_msgs std_srvs
stereo_image_proc stereo_msgs teleop_twist_joy teleop_twist_keyboard tf tf2 tf2_bullet tf2_eigen
tf2_geometry_msgs tf2_kdl tf2_msgs tf2_py tf2_ros tf2_sensor_msgs tf_conversions topic_tools trajectory_msgs
transmission_interface turtlesim unique_identifier_msgs urdf urdf_parser_plugin urdfdom_py usb_cam
velodyne_driver velodyne_pointcloud vision_msgs visualization_msgs warehouse_ros xacro
"""
COMMON_PACKAGES = frozenset(_PACKAGE_NAMES.split())
"""Names of packages; no other software has headers or Python modules of these names."""
CORE_HEADERS = {
    **dict.fromkeys(("macros.h", "platform.h", "types.h", "exception.h", "header.h", "datatypes.h"), "cpp_common"),
    **dict.fromkeys(("time.h", "duration.h", "rate.h"), "rostime"),
    **dict.fromkeys(("console.h", "assert.h", "static_assert.h"), "rosconsole"),
    "package.h": "roslib",
}
"""Packages of headers in the folder ``ros``; the others are of roscpp."""
CORE_PACKAGES = frozenset(("roscpp", "roscpp_core", "roscpp_serialization", "roscpp_traits", *CORE_HEADERS.values()))
"""Packages with headers in the folder ``ros``, of which each brings those of the ones below it."""
_BUILT_IN_NAMES = """
bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 string wstring time duration
Header
"""
BUILT_IN_TYPES = frozenset(_BUILT_IN_NAMES.split())
"""Types of fields that belong to no package."""


DESCRIPTION_SUFFIXES = (
    ".launch",
    ".launch.xml",
    ".urdf",
    ".xacro",
    ".test",
    ".launch.py",
    ".launch.yaml",
    ".launch.yml",
)
_INCLUDE_LINE = re.compile(r'[ \t]*#[ \t]*include[ \t]*[<"]([\w.+-]+)/([^>"\n]+)[>"]')
_DIRECTIVE_LINE = re.compile(r"[ \t]*#[ \t]*(if|ifdef|ifndef|endif|define)\b[ \t]*(\w*)")
_PACKAGE_REFERENCE = re.compile(r"\$\(find(?:-pkg-share)?[ \t]+([\w-]+)\)|package://([\w-]+)/")


@dataclass(frozen=True)
class Use:
    """Use of a package at a line."""

    name: str
    path: str
    line: int
    how: str
    """Description of the use, for messages."""
    accepted: frozenset[str] = frozenset()
    """Names of other packages that satisfy it too."""


def uses(package: Package, known: Collection[str]) -> Iterator[Use]:
    """Yield the uses of known packages, those of one file in their order."""
    yield from _in_cmake(package, known)
    for path in package.files:
        if path.endswith(CPP_SUFFIXES):
            yield from _included_packages(package, path, known)
        elif path.endswith(".py") and not path.endswith((".launch.py", "setup.py", "conf.py")):
            yield from _imported_packages(package, path, known)
        elif path.endswith((".msg", ".srv", ".action")):
            for each in fields_of(package.tree.text(path)):
                owner, separator, _ = each.type.partition("/")
                if separator:
                    yield Use(owner, path, each.line, "this type")
        if path.endswith(DESCRIPTION_SUFFIXES):
            yield from _named_packages(package, path, known)


def _in_cmake(package: Package, known: Collection[str]) -> Iterator[Use]:
    for command in package.commands("find_package"):
        words = command.arguments
        if not words or "QUIET" in command.texts:
            continue
        if words[0].text in known or words[0].text in ("catkin", "ament_cmake"):
            yield Use(words[0].text, command.path, command.line, "find_package")
        if words[0].text == "catkin":
            for each in words[1:]:
                if re.fullmatch(r"[a-z][a-z0-9_]*", each.text):
                    yield Use(each.text, command.path, each.line, "find_package")


def _included_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield what is included without a condition; a guard of the whole file is none."""
    depth, guard = 0, ""
    for number, line in enumerate(package.tree.text(path).split("\n"), 1):
        if "#" not in line:
            continue
        if directive := _DIRECTIVE_LINE.match(line):
            kind, name = directive[1], directive[2]
            if kind == "define":
                depth -= name == guard and bool(guard)
                guard = ""
            else:
                depth += -1 if kind == "endif" else 1
                guard = name if kind == "ifndef" and depth == 1 else ""
        elif (include := _INCLUDE_LINE.match(line)) and depth <= 0:
            owner, rest = include[1], include[2]
            if any(package.tree.has(package.inside(f"{folder}{owner}/{rest}")) for folder in ("", "include/", "src/")):
                continue
            if owner == "ros":
                yield Use(CORE_HEADERS.get(rest, "roscpp"), path, number, "this header", CORE_PACKAGES)
            elif owner in known:
                yield Use(owner, path, number, "this header")


def _imported_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield what is imported, but not what may fail."""
    text = package.tree.text(path)
    file = parse_python(text) if "import" in text else None
    nodes = [] if file is None else file.nodes
    tried = {
        id(below)
        for node in nodes
        if isinstance(node, ast.Try | ast.If | ast.ExceptHandler)
        for below in ast.iter_child_nodes(node)
    }
    for node in nodes:
        if id(node) in tried or not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        for level, name in imported_modules(node) if isinstance(node, ast.Import) else imported_modules(node)[:1]:
            owner = name.partition(".")[0]
            if owner in known and not level:
                yield Use(owner, path, node.lineno, "this import")


def _named_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield the packages that launch files and URDFs refer to (``$(find ...)``, ``package://``), without comments."""
    for number, line in enumerate(without_comments(package.tree.text(path)).split("\n"), 1):
        for match in _PACKAGE_REFERENCE.finditer(line):
            name = match[1] or match[2]
            if name in known:
                yield Use(name, path, number, "this path")
