"""Packages of a small ROS 2 robot: interfaces, a driver in C++, tools in Python, launch files of three kinds."""

FILES: dict[str, str] = {
    "ROBOT_interfaces/package.xml": """<?xml version="1.0"?>
<package format="3">
  <name>ROBOT_interfaces</name>
  <version>0.3.1</version>
  <description>Interfaces of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <depend>std_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
    "ROBOT_interfaces/CMakeLists.txt": """cmake_minimum_required(VERSION 3.8)
project(ROBOT_interfaces)

find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(std_msgs REQUIRED)

rosidl_generate_interfaces(${PROJECT_NAME}
  "action/Dock.action"
  "msg/STATUS.msg"
  "srv/SetMode.srv"
  DEPENDENCIES geometry_msgs std_msgs
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
""",
    "ROBOT_interfaces/action/Dock.action": """float64 speed
---
bool docked
---
float64 distance
""",
    "ROBOT_interfaces/msg/STATUS.msg": """std_msgs/Header header
geometry_msgs/Pose pose
float64 battery
uint8 MODE_IDLE=0
uint8 mode
""",
    "ROBOT_interfaces/srv/SetMode.srv": """uint8 mode
---
bool success
string message
""",
    "ROBOT_driver/package.xml": """<?xml version="1.0"?>
<package format="3">
  <name>ROBOT_driver</name>
  <version>0.3.1</version>
  <description>Driver of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <depend>ROBOT_interfaces</depend>
  <depend>geometry_msgs</depend>
  <depend>rclcpp</depend>
  <depend>rclcpp_action</depend>
  <depend>sensor_msgs</depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
    "ROBOT_driver/CMakeLists.txt": """cmake_minimum_required(VERSION 3.8)
project(ROBOT_driver)

find_package(ament_cmake REQUIRED)
find_package(ROBOT_interfaces REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rclcpp REQUIRED)
find_package(rclcpp_action REQUIRED)
find_package(sensor_msgs REQUIRED)

add_executable(base src/base.cpp)
ament_target_dependencies(base ROBOT_interfaces geometry_msgs rclcpp rclcpp_action)

add_executable(scanner src/scanner.cpp)
ament_target_dependencies(scanner rclcpp sensor_msgs)

install(TARGETS base scanner DESTINATION lib/${PROJECT_NAME})
install(DIRECTORY config DESTINATION share/${PROJECT_NAME})

ament_package()
""",
    "ROBOT_driver/config/driver.yaml": """base:
  ros__parameters:
    rate: 50.0
    wheel_radius: 0.1
    frame: base_link
scanner:
  ros__parameters:
    frame_id: laser_link
    beams: 720
""",
    "ROBOT_driver/src/base.cpp": """#include <memory>
#include <string>

#include "ROBOT_interfaces/action/dock.hpp"
#include "ROBOT_interfaces/msg/STATUS_SNAKE.hpp"
#include "ROBOT_interfaces/srv/set_mode.hpp"
#include "geometry_msgs/msg/twist.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_action/rclcpp_action.hpp"

using ROBOT_interfaces::srv::SetMode;
using Dock = ROBOT_interfaces::action::Dock;
using GoalHandle = rclcpp_action::ServerGoalHandle<Dock>;

class Base : public rclcpp::Node
{
public:
  Base() : Node("base")
  {
    declare_parameter("rate", 50.0);
    declare_parameter<double>("wheel_radius", 0.1);
    frame_ = this->declare_parameter<std::string>("frame", "base_link");
    status_ = create_publisher<ROBOT_interfaces::msg::STATUS>("TOPIC_status", 10);
    command_ = this->create_subscription<geometry_msgs::msg::Twist>(
      "cmd_vel", 1, std::bind(&Base::on_command, this, std::placeholders::_1));
    mode_ = create_service<SetMode>(
      "set_mode", std::bind(&Base::on_mode, this, std::placeholders::_1, std::placeholders::_2));
    dock_ = rclcpp_action::create_server<Dock>(
      this, "dock", std::bind(&Base::on_goal, this, std::placeholders::_1, std::placeholders::_2),
      std::bind(&Base::on_cancel, this, std::placeholders::_1),
      std::bind(&Base::on_accepted, this, std::placeholders::_1));
  }

private:
  void on_command(const geometry_msgs::msg::Twist::SharedPtr message)
  {
    ROBOT_interfaces::msg::STATUS status;
    status.header.stamp = now();
    status.header.frame_id = "base_link";
    status.battery = message->linear.x;
    status_->publish(status);
  }
  void on_mode(const std::shared_ptr<SetMode::Request> request, std::shared_ptr<SetMode::Response> response)
  {
    response->success = request->mode < 3;
  }
  rclcpp_action::GoalResponse on_goal(const rclcpp_action::GoalUUID &, std::shared_ptr<const Dock::Goal>)
  {
    return rclcpp_action::GoalResponse::ACCEPT_AND_EXECUTE;
  }
  rclcpp_action::CancelResponse on_cancel(const std::shared_ptr<GoalHandle>)
  {
    return rclcpp_action::CancelResponse::ACCEPT;
  }
  void on_accepted(const std::shared_ptr<GoalHandle>) {}

  std::string frame_;
  rclcpp::Publisher<ROBOT_interfaces::msg::STATUS>::SharedPtr status_;
  rclcpp::Subscription<geometry_msgs::msg::Twist>::SharedPtr command_;
  rclcpp::Service<SetMode>::SharedPtr mode_;
  rclcpp_action::Server<Dock>::SharedPtr dock_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<Base>());
  rclcpp::shutdown();
  return 0;
}
""",
    "ROBOT_driver/src/scanner.cpp": """#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/laser_scan.hpp"

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  auto node = rclcpp::Node::make_shared("scanner");
  const std::string frame = node->declare_parameter("frame_id", "laser_link");
  const int beams = node->declare_parameter<int>("beams", 360);
  const std::string topic = "TOPIC_scan";
  auto scans = node->create_publisher<sensor_msgs::msg::LaserScan>(topic, rclcpp::SensorDataQoS());
  RCLCPP_INFO(node->get_logger(), "%d beams in %s", beams, frame.c_str());
  rclcpp::spin(node);
  rclcpp::shutdown();
  return 0;
}
""",
    "ROBOT_tools/package.xml": """<?xml version="1.0"?>
<package format="3">
  <name>ROBOT_tools</name>
  <version>0.3.1</version>
  <description>Tools of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>Apache-2.0</license>
  <exec_depend>ROBOT_interfaces</exec_depend>
  <exec_depend>geometry_msgs</exec_depend>
  <exec_depend>rclpy</exec_depend>
  <exec_depend>sensor_msgs</exec_depend>
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
""",
    "ROBOT_tools/setup.cfg": """[develop]
script_dir=$base/lib/ROBOT_tools
[install]
install_scripts=$base/lib/ROBOT_tools
""",
    "ROBOT_tools/setup.py": """from setuptools import setup

package_name = "ROBOT_tools"

setup(
    name=package_name,
    version="0.3.1",
    packages=[package_name],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/config", ["config/tools.yaml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="Team",
    maintainer_email="team@example.org",
    description="Tools of ROBOT.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "follower = ROBOT_tools.follower:main",
            "monitor = ROBOT_tools.monitor:main",
        ],
    },
)
""",
    "ROBOT_tools/resource/ROBOT_tools": "",
    "ROBOT_tools/config/tools.yaml": """follower:
  ros__parameters:
    gain: 0.4
    topics: [front, rear]
""",
    "ROBOT_tools/ROBOT_tools/__init__.py": "",
    "ROBOT_tools/ROBOT_tools/follower.py": """import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan


class Follower(Node):
    def __init__(self):
        super().__init__("follower")
        self.declare_parameter("gain", 0.5)
        self.declare_parameter("topics", ["front"])
        quality = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(LaserScan, "TOPIC_scan", self.on_scan, quality)

    def on_scan(self, scan):
        command = Twist()
        command.linear.x = self.get_parameter("gain").value * min(scan.ranges)
        self.publisher.publish(command)


def main():
    rclpy.init()
    rclpy.spin(Follower())
""",
    "ROBOT_tools/ROBOT_tools/monitor.py": """import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from ROBOT_interfaces.action import Dock
from ROBOT_interfaces.msg import STATUS
from ROBOT_interfaces.srv import SetMode


class Monitor(Node):
    def __init__(self):
        super().__init__("monitor")
        self.declare_parameters("", [("mode", 1), ("name", "ROBOT")])
        self.set_mode = self.create_client(SetMode, "set_mode")
        self.dock = ActionClient(self, Dock, "dock")
        self.create_subscription(STATUS, "TOPIC_status", self.on_status, 10)

    def on_status(self, status):
        self.get_logger().info(f"battery {status.battery}")


def main():
    rclpy.init()
    rclpy.spin(Monitor())
""",
    "ROBOT_description/package.xml": """<?xml version="1.0"?>
<package format="3">
  <name>ROBOT_description</name>
  <version>0.3.1</version>
  <description>Description of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
    "ROBOT_description/CMakeLists.txt": """cmake_minimum_required(VERSION 3.8)
project(ROBOT_description)
find_package(ament_cmake REQUIRED)
install(DIRECTORY launch meshes urdf DESTINATION share/${PROJECT_NAME})
ament_package()
""",
    "ROBOT_description/launch/description.launch.py": """import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    share = get_package_share_directory("ROBOT_description")
    with open(os.path.join(share, "urdf", "robot.urdf")) as file:
        description = file.read()
    return LaunchDescription(
        [
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": description}],
            ),
        ]
    )
""",
    "ROBOT_bringup/package.xml": """<?xml version="1.0"?>
<package format="3">
  <name>ROBOT_bringup</name>
  <version>0.3.1</version>
  <description>Launch files of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>ROBOT_description</exec_depend>
  <exec_depend>ROBOT_driver</exec_depend>
  <exec_depend>ROBOT_tools</exec_depend>
  <exec_depend>tf2_ros</exec_depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
    "ROBOT_bringup/CMakeLists.txt": """cmake_minimum_required(VERSION 3.8)
project(ROBOT_bringup)
find_package(ament_cmake REQUIRED)
install(DIRECTORY launch DESTINATION share/${PROJECT_NAME})
ament_package()
""",
    "ROBOT_bringup/launch/robot.launch.py": """import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource, PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    driver = os.path.join(get_package_share_directory("ROBOT_driver"), "config", "driver.yaml")
    tools = PathJoinSubstitution([FindPackageShare("ROBOT_tools"), "config", "tools.yaml"])
    description = os.path.join(get_package_share_directory("ROBOT_description"), "launch", "description.launch.py")
    sensors = os.path.join(get_package_share_directory("ROBOT_bringup"), "launch", "sensors.launch.xml")
    return LaunchDescription(
        [
            DeclareLaunchArgument("mode", default_value="1"),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(description)),
            IncludeLaunchDescription(
                AnyLaunchDescriptionSource(sensors),
                launch_arguments={"frame": "laser_link"}.items(),
            ),
            Node(package="ROBOT_driver", executable="base", name="base", parameters=[driver]),
            Node(
                package="ROBOT_tools",
                executable="follower",
                name="follower",
                parameters=[tools, {"gain": 0.3}],
                remappings=[("TOPIC_scan", "TOPIC_scan_raw")],
            ),
            Node(
                package="ROBOT_tools",
                executable="monitor",
                name="monitor",
                parameters=[{"mode": LaunchConfiguration("mode"), "name": "first"}],
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=["--frame-id", "camera_link", "--child-frame-id", "camera_mark"],
            ),
        ]
    )
""",
    "ROBOT_bringup/launch/sensors.launch.xml": """<launch>
  <arg name="frame"/>
  <node pkg="ROBOT_driver" exec="scanner" name="scanner">
    <param from="$(find-pkg-share ROBOT_driver)/config/driver.yaml"/>
    <param name="frame_id" value="$(var frame)"/>
    <remap from="TOPIC_scan" to="TOPIC_scan_raw"/>
  </node>
</launch>
""",
    "ROBOT_bringup/launch/all.launch.yaml": """launch:
- arg:
    name: mode
    default: "1"
- include:
    file: $(find-pkg-share ROBOT_bringup)/launch/robot.launch.py
    arg:
    - name: mode
      value: $(var mode)
""",
}
"""Texts of the files by path; ROBOT, STATUS, TOPIC stand for names that are drawn."""
