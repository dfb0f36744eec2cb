"""A modality that the package does not know: an entry in `MODALITIES` and a simulated sensor are enough for it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from calibration.base.records import record
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.modalities import LIDAR2D, MODALITIES, IndexedPoints, Modality, PointData
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.evaluation.truth import find_truth
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.robot.simulation.sensors import SIMULATED_SENSORS, SimulatedLidar2d
from calibration.robot.simulation.sensors.sensor import Data
from tests.pipeline.systems import with_scanner

SONAR = "lidar_right"


@dataclass(frozen=True)
class Echoes:
    """Ranges in whole millimetres, 0 for none, along beams in the sensor's plane."""

    message: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.message["ranges_mm"])

    def take(self, index: np.ndarray) -> np.ndarray:
        ranges = np.array(self.message["ranges_mm"], float)[index] / 1000
        angles = self.message["first_rad"] + self.message["step_rad"] * index
        return np.where(ranges > 0, ranges, np.nan)[:, None] * np.stack(
            [np.cos(angles), np.sin(angles), np.zeros(len(index))], -1
        )


def read_echoes(message: Node, _: object) -> IndexedPoints:
    return Echoes(message.value)


SONAR2D = Modality(
    "sonar2d",
    "lidar",
    "SonarEcho",
    points=PointData("echo's {} beams", "beam {} has no range", read_echoes, LIDAR2D.point_data.noise, 3, planar=True),
)


@record(case="snake", nulls=True)
class SimulatedSonar(SimulatedLidar2d):
    """A sonar in the place of a 2D LiDAR, with a message of its own."""

    modality: ClassVar[Modality] = SONAR2D
    label_name: ClassVar[str] = "beams"

    def message(self, data: Data) -> dict[str, Any]:
        ranges = np.rint(1000 * data).astype(int).tolist()
        return {"first_rad": self.angles[0], "step_rad": self.step, "ranges_mm": ranges}


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a system with a sonar, whose modality is registered."""
    monkeypatch.setitem(MODALITIES, SONAR2D.name, SONAR2D)
    monkeypatch.setitem(SIMULATED_SENSORS, SONAR2D.name, SimulatedSonar)
    folder = tmp_path / "system"
    folder.mkdir()
    config = with_scanner(folder) / "config.yml"
    config.write_text(config.read_text().replace("lidar2d", SONAR2D.name))
    return folder


def test_it_is_collected_calibrated_and_evaluated(source: Path, tmp_path: Path) -> None:
    output = tmp_path / "output"
    assert collect_dataset(CollectionRequest(source, motion="generate:10"), output).verdict == "pass"

    described = json.loads((output / "dataset.json").read_text())["sensors"][SONAR]
    assert (described["modality"], described["msg_type"]) == ("sonar2d", "SonarEcho")
    dataset = read_dataset(output)
    found = calibrate(dataset)
    assert found.noise_levels.lidar2d_range == pytest.approx(0.01, rel=0.2)
    table = parse_evaluation(f"lidar-to-rgb:{SONAR}:rgb_left").run(found.dataset, find_truth(dataset))
    assert 0 < table.average("RMS (pix)") < 6
