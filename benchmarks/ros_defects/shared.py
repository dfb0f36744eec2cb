"""Files of both robots: the description, and the calibration of their sensors."""

_MESH = (
    "solid base\nfacet\nouter loop\nvertex 0 0 0\nvertex {0} 0 0\nvertex 0 {0} 0\nendloop\nendfacet\nendsolid base\n"
)

FILES: dict[str, str] = {
    "ROBOT_description/urdf/robot.urdf": """<?xml version="1.0"?>
<robot name="ROBOT">
  <link name="base_link">
    <visual>
      <geometry><mesh filename="package://ROBOT_description/meshes/base.stl"/></geometry>
    </visual>
  </link>
  <link name="laser_link"/>
  <link name="camera_link"/>
  <link name="camera_optical"/>
  <joint name="laser_joint" type="fixed">
    <parent link="base_link"/>
    <child link="laser_link"/>
  </joint>
  <joint name="camera_joint" type="fixed">
    <parent link="base_link"/>
    <child link="camera_link"/>
  </joint>
  <joint name="camera_optical_joint" type="fixed">
    <parent link="camera_link"/>
    <child link="camera_optical"/>
  </joint>
</robot>
""",
    "ROBOT_description/meshes/base.stl": _MESH.format(1),
    "calibration/config.yml": """description_file: package://ROBOT_description/urdf/robot.urdf
bag_file: ""
world_link: base_link
sensors:
  laser:
    link: laser_link
    parent_link: base_link
    child_link: laser_link
    topic_name: /TOPIC_scan_raw
    modality: lidar2d
  camera:
    link: camera_optical
    parent_link: base_link
    child_link: camera_link
    topic_name: /camera/image_raw
    modality: rgb
additional_tfs:
joints:
calibration_patterns:
  board:
    link: board_link
    parent_link: base_link
    fixed: false
    pattern_type: charuco
    dictionary: DICT_5X5_100
    mesh_file: ""
    border_size: {x: 0.02, y: 0.02}
    dimension: {x: 8, y: 5}
    size: 0.08
    inner_size: 0.06
anchored_sensor: laser
max_duration_between_msgs: 100
version: 3.0
""",
}
"""Texts of the files by path; ROBOT and TOPIC stand for names that are drawn."""
