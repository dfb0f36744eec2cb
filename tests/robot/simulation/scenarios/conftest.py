from collections.abc import Callable
from pathlib import Path

import pytest

from calibration.robot.simulation.scenarios.scenario_set import ScenarioSet, read_scenario_set
from calibration.robot.simulation.system import System

ReadSet = Callable[..., ScenarioSet]


@pytest.fixture
def read_set(tmp_path: Path, systems: dict[str, System]) -> ReadSet:
    """Read a scenario set from its text, for t2rgb or another system."""

    def read(text: str, system: str = "t2rgb") -> ScenarioSet:
        path = tmp_path / "scenarios.yml"
        path.write_text(text)
        return read_scenario_set(path, systems[system])

    return read
