from pathlib import Path

import pytest

from calibration.simulation.system import System, read_system

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
FREE = ("t2rgb", "rlbot", "riwbot")
"""The systems in which a pattern can be brought to any pose before a sensor."""
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
