"""Names of ROS packages that are common, so that what uses them is recognised without them."""

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
