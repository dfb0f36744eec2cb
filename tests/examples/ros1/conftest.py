"""The example's folder, its own Python on the path, and a dataset of its system from our simulation."""

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.dataset_folder import dataset_document
from calibration.robot.simulation.kinematics import Play, play
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.record import Record, collect_pose, kept
from calibration.robot.simulation.system import read_system

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "ros1"
sys.path.insert(0, str(EXAMPLE / "robot"))  # as the scripts there find it


@dataclass(frozen=True)
class Collected:
    """What our simulation collects of the example's system."""

    folder: Path
    """With ``dataset.json``."""
    dataset: Dataset
    """Its transforms are the truth."""
    play: Play
    records: list[Record]
    """Of every pose."""


@pytest.fixture(scope="session")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Collected:
    system = read_system(EXAMPLE / "system")
    played = play(system, read_motion(EXAMPLE / "system" / "motion.json"), 1)
    records = [collect_pose(played, number, Requirements(), images=False)[0] for number in range(len(played))]
    folder = tmp_path_factory.mktemp("ros1")
    write_document(dataset_document(system, kept(records)), folder / "dataset.json")
    return Collected(folder, read_dataset(folder), played, records)
