from dataclasses import replace
from pathlib import Path

import pytest

from calibration.ci.execution.tasks import Workspace
from calibration.robot.simulation.collection.capture import Requirements
from calibration.robot.simulation.collection.record import Record, collect
from calibration.robot.simulation.motion.sequence import Motion, moving_model, read_motion
from calibration.robot.simulation.placement import Play, play
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import DATASETS


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
