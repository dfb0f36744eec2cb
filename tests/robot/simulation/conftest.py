from pathlib import Path

import pytest

from calibration.base.arrays import Array, BoolArray
from calibration.robot.simulation.placement import Placement, views
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.camera import CornerViews
from calibration.robot.simulation.sensors.sensor import Views
from calibration.robot.simulation.system import System, read_system

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
FREE = ("t2rgb", "rlbot", "riwbot")
"""Systems in which a pattern can be moved to any pose in front of a sensor."""
SYSTEMS = (*FREE, "softbot", "spjbot")


@pytest.fixture(scope="session")
def systems() -> dict[str, System]:
    """The systems that ship, by name."""
    return {name: read_system(DATASETS / name) for name in SYSTEMS}


@pytest.fixture
def system_copy(tmp_path: Path) -> Path:
    """A folder "mine" with rlbot's description, to be broken."""
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("robot.urdf", "config.yml", "simulation.yml"):
        (folder / name).write_bytes((DATASETS / "rlbot" / name).read_bytes())
    return folder


def detects(system: System, sensor: str, pattern: str, placement: Placement) -> BoolArray:
    """At which poses (N,) a sensor is expected to detect a pattern."""
    return system.sensors[sensor].detects(views(system, placement, sensor, pattern))


def corner_views(system: System, camera: str, pattern: str, placement: Placement) -> CornerViews:
    """Expected views of a pattern's corners by a camera."""
    return system.cameras[camera].corner_views(views(system, placement, camera, pattern))


def one_view(system: System, T_world_sensor: Array, T_world_pattern: Array, scene: Scene) -> Views:
    """The system's pattern before some sensor, once; poses (4, 4)."""
    pattern = "pattern_1"
    poses = (T_world_sensor[None], T_world_pattern[None])
    return Views(system.configuration.patterns[pattern], system.patterns[pattern], scene, *poses)
