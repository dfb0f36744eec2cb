"""Systems that do not ship, described by what they have more than one that does."""

from pathlib import Path

from tests.pipeline.conftest import DATASETS

MAST = """
  <link name="depth_link"/>
  <link name="depth_optical"/>
  <joint name="to_depth_link" type="fixed">
    <parent link="tripod_left_support"/>
    <child link="depth_link"/>
    <origin xyz="0.015 -0.1 0.06" rpy="0.02 0.03 -0.1"/>
  </joint>
  <joint name="to_depth_optical" type="fixed">
    <parent link="depth_link"/>
    <child link="depth_optical"/>
    <origin xyz="0 0 0" rpy="-1.5707963267949 0 -1.5707963267949"/>
  </joint>
</robot>"""
SENSOR = """
  depth:
    link: depth_optical
    parent_link: tripod_left_support
    child_link: depth_link
    topic_name: /depth/image_raw
    modality: depth
    throttle:
additional_tfs:"""


def with_depth_camera(folder: Path) -> Path:
    """rlbot with a depth camera, whose lens is bent, beside its camera and its LiDAR."""
    source = DATASETS / "rlbot"
    simulation = (source / "simulation.yml").read_text()
    lens = "  depth: {width: 640, height: 480, hfov_deg: 65, distortion: [0.05, -0.03, 0.001, -0.001, 0]}\nscene:"
    (folder / "robot.urdf").write_text((source / "robot.urdf").read_text().replace("\n</robot>", MAST))
    (folder / "config.yml").write_text((source / "config.yml").read_text().replace("\nadditional_tfs:", SENSOR))
    (folder / "simulation.yml").write_text(simulation.replace("scene:", lens, 1))
    return folder


def with_scanner(folder: Path) -> Path:
    """rlbot with a 2D LiDAR in the place of its LiDAR."""
    source = DATASETS / "rlbot"
    simulation = (source / "simulation.yml").read_text()
    start, end = simulation.index("    rings: 16"), simulation.index("scene:")
    flat = "    rays: 1081\n    angle_deg: [-135, 135]\n    range_m: [0.1, 30]\n    noise_m: 0.01\n"
    (folder / "robot.urdf").write_bytes((source / "robot.urdf").read_bytes())
    (folder / "config.yml").write_text((source / "config.yml").read_text().replace("lidar3d", "lidar2d"))
    (folder / "simulation.yml").write_text(simulation[:start] + flat + simulation[end:])
    return folder
