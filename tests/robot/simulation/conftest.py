from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base.arrays import Array, BoolArray
from calibration.ci.execution.tasks import Workspace
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.kinematics import Placement, Play, play, views
from calibration.robot.simulation.motion import Motion, moving_model, read_motion
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.record import Record, collect
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


def record_workspace(folder: Path) -> Workspace[Record]:
    """A folder for the records of poses."""
    return Workspace(folder, Record.to_json, Record.from_json)


def own_motion(system: System) -> Motion:
    return read_motion(DATASETS / system.name / "motion.json")


def with_a_lost_pose(motion: Motion) -> Motion:
    """The first three poses, the second one high above the sensors."""
    poses = motion.take([0, 1, 2]).model_poses
    assert poses is not None
    poses[1, 2, 3] += 5.0
    return replace(moving_model(poses), source="a motion")


@pytest.fixture(scope="session")
def rlbot_play(systems: dict[str, System]) -> Play:
    """rlbot at three poses, of which one is lost."""
    system = systems["rlbot"]
    return play(system, with_a_lost_pose(own_motion(system)), seed=1)


@pytest.fixture(scope="session")
def rlbot_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the files of `rlbot_records`."""
    return tmp_path_factory.mktemp("files")


@pytest.fixture(scope="session")
def rlbot_records(rlbot_play: Play, rlbot_files: Path) -> list[Record]:
    return collect(rlbot_play, Requirements(), record_workspace(rlbot_files), jobs=1)


@pytest.fixture(scope="session")
def motions(systems: dict[str, System]) -> dict[str, Motion]:
    """A motion of 24 poses of each system."""
    return {name: generate_motion(system, 24, seed=3) for name, system in systems.items()}
