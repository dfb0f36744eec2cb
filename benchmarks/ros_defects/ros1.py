"""Packages of a small ROS 1 robot: messages, a driver in C++, tools in Python, launch files."""

FILES: dict[str, str] = {
    "ROBOT_msgs/package.xml": """<?xml version="1.0"?>
<package format="2">
  <name>ROBOT_msgs</name>
  <version>1.2.0</version>
  <description>Messages of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <build_depend>message_generation</build_depend>
  <depend>geometry_msgs</depend>
  <depend>std_msgs</depend>
  <exec_depend>message_runtime</exec_depend>
</package>
""",
    "ROBOT_msgs/CMakeLists.txt": """cmake_minimum_required(VERSION 3.0.2)
project(ROBOT_msgs)

find_package(catkin REQUIRED COMPONENTS
  geometry_msgs
  message_generation
  std_msgs
)

add_message_files(FILES
  STATUS.msg
  Wheel.msg
)
add_service_files(FILES SetMode.srv)
generate_messages(DEPENDENCIES geometry_msgs std_msgs)

catkin_package(CATKIN_DEPENDS geometry_msgs message_runtime std_msgs)
""",
    "ROBOT_msgs/msg/STATUS.msg": """# State of the robot
Header header
Wheel[] wheels
geometry_msgs/Pose pose
float64 battery
uint8 MODE_IDLE=0
uint8 mode
""",
    "ROBOT_msgs/msg/Wheel.msg": """string name
float64 speed
""",
    "ROBOT_msgs/srv/SetMode.srv": """uint8 mode
---
bool success
string message
""",
    "ROBOT_driver/package.xml": """<?xml version="1.0"?>
<package format="2">
  <name>ROBOT_driver</name>
  <version>1.2.0</version>
  <description>Driver of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <depend>ROBOT_msgs</depend>
  <depend>geometry_msgs</depend>
  <depend>roscpp</depend>
  <depend>sensor_msgs</depend>
  <depend>tf2_ros</depend>
</package>
""",
    "ROBOT_driver/CMakeLists.txt": """cmake_minimum_required(VERSION 3.0.2)
project(ROBOT_driver)

find_package(catkin REQUIRED COMPONENTS
  ROBOT_msgs
  geometry_msgs
  roscpp
  sensor_msgs
  tf2_ros
)

catkin_package(INCLUDE_DIRS include LIBRARIES ${PROJECT_NAME} CATKIN_DEPENDS ROBOT_msgs roscpp)
include_directories(include ${catkin_INCLUDE_DIRS})

add_library(${PROJECT_NAME} src/base.cpp)
target_link_libraries(${PROJECT_NAME} ${catkin_LIBRARIES})

set(NODES base scanner)
foreach(node ${NODES})
  add_executable(${node}_node src/${node}_node.cpp)
  add_dependencies(${node}_node ${catkin_EXPORTED_TARGETS})
  target_link_libraries(${node}_node ${PROJECT_NAME} ${catkin_LIBRARIES})
  install(TARGETS ${node}_node DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
endforeach()

install(TARGETS ${PROJECT_NAME} DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION})
install(DIRECTORY include/${PROJECT_NAME}/ DESTINATION ${CATKIN_PACKAGE_INCLUDE_DESTINATION})
install(DIRECTORY config DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
""",
    "ROBOT_driver/config/driver.yaml": """base:
  rate: 50.0
  wheel_radius: 0.1
frame: base_link
""",
    "ROBOT_driver/include/ROBOT_driver/base.h": """#ifndef ROBOT_DRIVER_BASE_H
#define ROBOT_DRIVER_BASE_H

#include <string>

#include <ROBOT_msgs/SetMode.h>
#include <ROBOT_msgs/STATUS.h>
#include <geometry_msgs/Twist.h>
#include <ros/ros.h>

namespace driver
{
class Base
{
public:
  explicit Base(ros::NodeHandle& nh);
  void spinOnce();

private:
  void onCommand(const geometry_msgs::Twist::ConstPtr& message);
  bool onMode(ROBOT_msgs::SetMode::Request& request, ROBOT_msgs::SetMode::Response& response);

  ros::NodeHandle private_nh_;
  ros::Publisher status_pub_;
  ros::Subscriber command_sub_;
  ros::ServiceServer mode_server_;
  double rate_;
  std::string frame_;
};
}  // namespace driver

#endif
""",
    "ROBOT_driver/src/base.cpp": """#include <ROBOT_driver/base.h>

namespace driver
{
Base::Base(ros::NodeHandle& nh) : private_nh_("~")
{
  private_nh_.param("rate", rate_, 50.0);
  double radius;
  private_nh_.param<double>("wheel_radius", radius, 0.1);
  nh.param<std::string>("frame", frame_, "base_link");
  status_pub_ = nh.advertise<ROBOT_msgs::STATUS>("TOPIC_status", 10);
  command_sub_ = nh.subscribe("cmd_vel", 1, &Base::onCommand, this);
  mode_server_ = nh.advertiseService("set_mode", &Base::onMode, this);
}

void Base::onCommand(const geometry_msgs::Twist::ConstPtr& message)
{
  ROS_DEBUG("%f", message->linear.x);
}

bool Base::onMode(ROBOT_msgs::SetMode::Request& request, ROBOT_msgs::SetMode::Response& response)
{
  response.success = request.mode < 3;
  return true;
}

void Base::spinOnce()
{
  ROBOT_msgs::STATUS status;
  status.header.stamp = ros::Time::now();
  status.header.frame_id = "base_link";
  status_pub_.publish(status);
}
}  // namespace driver
""",
    "ROBOT_driver/src/base_node.cpp": """#include <ROBOT_driver/base.h>

int main(int argc, char** argv)
{
  ros::init(argc, argv, "base");
  ros::NodeHandle nh;
  driver::Base base(nh);
  ros::Rate rate(50);
  while (ros::ok())
  {
    base.spinOnce();
    ros::spinOnce();
    rate.sleep();
  }
  return 0;
}
""",
    "ROBOT_driver/src/scanner_node.cpp": """#include <geometry_msgs/TransformStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/LaserScan.h>
#include <tf2_ros/transform_broadcaster.h>

static const char* const SCAN_TOPIC = "TOPIC_scan";

int main(int argc, char** argv)
{
  ros::init(argc, argv, "scanner");
  ros::NodeHandle nh;
  ros::NodeHandle pnh("~");
  std::string frame;
  pnh.param<std::string>("frame_id", frame, "laser_link");
  ros::Publisher pub = nh.advertise<sensor_msgs::LaserScan>(SCAN_TOPIC, 5);
  tf2_ros::TransformBroadcaster broadcaster;
  geometry_msgs::TransformStamped odometry;
  odometry.header.frame_id = "odom";
  odometry.child_frame_id = "base_link";
  broadcaster.sendTransform(odometry);
  ros::spin();
  return 0;
}
""",
    "ROBOT_tools/package.xml": """<?xml version="1.0"?>
<package format="2">
  <name>ROBOT_tools</name>
  <version>1.2.0</version>
  <description>Tools of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <exec_depend>ROBOT_msgs</exec_depend>
  <exec_depend>geometry_msgs</exec_depend>
  <exec_depend>rospy</exec_depend>
  <exec_depend>sensor_msgs</exec_depend>
</package>
""",
    "ROBOT_tools/CMakeLists.txt": """cmake_minimum_required(VERSION 3.0.2)
project(ROBOT_tools)

find_package(catkin REQUIRED)
catkin_python_setup()
catkin_package()

catkin_install_python(PROGRAMS
  scripts/follower.py
  scripts/monitor.py
  DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION}
)
""",
    "ROBOT_tools/setup.py": """from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(**generate_distutils_setup(packages=["ROBOT_tools"], package_dir={"": "src"}))
""",
    "ROBOT_tools/src/ROBOT_tools/__init__.py": "",
    "ROBOT_tools/src/ROBOT_tools/limits.py": """FASTEST = 0.5


def limited(speed):
    return max(-FASTEST, min(FASTEST, speed))
""",
    "ROBOT_tools/scripts/follower.py": """#!/usr/bin/env python3
import rospy
from geometry_msgs.msg import Twist
from ROBOT_tools.limits import limited
from sensor_msgs.msg import LaserScan


class Follower:
    def __init__(self):
        self.gain = rospy.get_param("~gain", 0.5)
        self.publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        rospy.Subscriber("TOPIC_scan", LaserScan, self.on_scan)

    def on_scan(self, scan):
        command = Twist()
        command.linear.x = limited(self.gain * min(scan.ranges))
        self.publisher.publish(command)


if __name__ == "__main__":
    rospy.init_node("follower")
    Follower()
    rospy.spin()
""",
    "ROBOT_tools/scripts/monitor.py": """#!/usr/bin/env python3
import rospy
from ROBOT_msgs.msg import STATUS
from ROBOT_msgs.srv import SetMode


def on_status(status):
    rospy.loginfo("battery %f", status.battery)


if __name__ == "__main__":
    rospy.init_node("monitor")
    rospy.wait_for_service("set_mode")
    set_mode = rospy.ServiceProxy("set_mode", SetMode)
    set_mode(rospy.get_param("~mode", 1))
    rospy.Subscriber("TOPIC_status", STATUS, on_status)
    rospy.spin()
""",
    "ROBOT_description/package.xml": """<?xml version="1.0"?>
<package format="2">
  <name>ROBOT_description</name>
  <version>1.2.0</version>
  <description>Description of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <exec_depend>robot_state_publisher</exec_depend>
</package>
""",
    "ROBOT_description/CMakeLists.txt": """cmake_minimum_required(VERSION 3.0.2)
project(ROBOT_description)
find_package(catkin REQUIRED)
catkin_package()
install(DIRECTORY launch meshes urdf DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
""",
    "ROBOT_description/launch/description.launch": """<launch>
  <param name="robot_description" textfile="$(find ROBOT_description)/urdf/robot.urdf"/>
  <node pkg="robot_state_publisher" type="robot_state_publisher" name="robot_state_publisher"/>
</launch>
""",
    "ROBOT_bringup/package.xml": """<?xml version="1.0"?>
<package format="2">
  <name>ROBOT_bringup</name>
  <version>1.2.0</version>
  <description>Launch files of ROBOT.</description>
  <maintainer email="team@example.org">Team</maintainer>
  <license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend>
  <exec_depend>ROBOT_description</exec_depend>
  <exec_depend>ROBOT_driver</exec_depend>
  <exec_depend>ROBOT_tools</exec_depend>
  <exec_depend>tf2_ros</exec_depend>
</package>
""",
    "ROBOT_bringup/CMakeLists.txt": """cmake_minimum_required(VERSION 3.0.2)
project(ROBOT_bringup)
find_package(catkin REQUIRED)
catkin_package()
install(DIRECTORY config launch DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
""",
    "ROBOT_bringup/config/tools.yaml": """gain: 0.4
""",
    "ROBOT_bringup/launch/robot.launch": """<launch>
  <arg name="mode" default="1" doc="mode of the base at the start"/>
  <arg name="camera" default="true"/>
  <include file="$(find ROBOT_description)/launch/description.launch"/>
  <include file="$(find ROBOT_bringup)/launch/sensors.launch">
    <arg name="frame" value="laser_link"/>
  </include>
  <rosparam command="load" file="$(find ROBOT_driver)/config/driver.yaml"/>
  <node pkg="ROBOT_driver" type="base_node" name="base" output="screen"/>
  <node pkg="ROBOT_tools" type="follower.py" name="follower">
    <rosparam command="load" file="$(find ROBOT_bringup)/config/tools.yaml"/>
    <remap from="TOPIC_scan" to="TOPIC_scan_raw"/>
  </node>
  <node pkg="ROBOT_tools" type="monitor.py" name="monitor">
    <param name="mode" value="$(arg mode)"/>
  </node>
  <node if="$(arg camera)" pkg="tf2_ros" type="static_transform_publisher" name="camera_mount"
        args="0 0 0.1 0 0 0 camera_link camera_mark"/>
</launch>
""",
    "ROBOT_bringup/launch/sensors.launch": """<launch>
  <arg name="frame"/>
  <node pkg="ROBOT_driver" type="scanner_node" name="scanner">
    <param name="frame_id" value="$(arg frame)"/>
    <remap from="TOPIC_scan" to="TOPIC_scan_raw"/>
  </node>
</launch>
""",
}
"""Texts of the files by path; ROBOT, STATUS, TOPIC stand for names that are drawn."""
