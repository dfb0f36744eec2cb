from pathlib import Path

import pytest

from calibration.robot.simulation.system import System, read_system

DATASETS = Path(__file__).resolve().parents[3] / "datasets"

ROBOT = """<robot name="rail">
  <link name="world"/><link name="cart"/><link name="mount"/><link name="optical"/><link name="board"/>
  <joint name="slide" type="prismatic">
    <parent link="world"/><child link="cart"/><origin xyz="0 0 1"/><axis xyz="1 0 0"/><limit lower="-1" upper="1"/>
  </joint>
  <joint name="pan" type="continuous"><parent link="cart"/><child link="mount"/><axis xyz="0 0 1"/></joint>
  <joint name="lens" type="fixed">
    <parent link="mount"/><child link="optical"/><origin rpy="-1.5707963 0 -1.5707963"/>
  </joint>
  <joint name="wall" type="fixed">
    <parent link="world"/><child link="board"/><origin xyz="3 0.3 1.3" rpy="-1.5707963 0 -1.5707963"/>
  </joint>
</robot>"""
CONFIGURATION = """
world_link: world
sensors:
  eye: {link: optical, parent_link: cart, child_link: mount, topic_name: /eye, modality: rgb, throttle: }
additional_tfs:
joints:
anchored_sensor:
calibration_patterns:
  board:
    {link: board, parent_link: world, fixed: true, pattern_type: charuco, dictionary: DICT_5X5_100,
     border_size: 0.02, dimension: {x: 7, y: 5}, size: 0.08, inner_size: 0.06}
"""


@pytest.fixture(scope="session")
def systems() -> dict[str, System]:
    """The systems that ship, by name."""
    return {name: read_system(DATASETS / name) for name in ("t2rgb", "rlbot", "riwbot")}


@pytest.fixture(scope="session")
def rail_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera that slides along a rail and pans, and a board on the wall."""
    folder = tmp_path_factory.mktemp("systems") / "rail"
    folder.mkdir()
    (folder / "robot.urdf").write_text(ROBOT)
    (folder / "config.yml").write_text(CONFIGURATION)
    (folder / "simulation.yml").write_text("sensors:\n  eye: {width: 320, height: 240, hfov_deg: 60}\n")
    return folder


@pytest.fixture
def rail(rail_folder: Path) -> System:
    return read_system(rail_folder)
