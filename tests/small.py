"""The small system: t2rgb with a quarter of its pixels, for tests that look at anything but the pictures."""

import json
from pathlib import Path

import pytest

from calibration.robot.simulation.motion import motion_document
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.system import read_system

T2RGB = Path(__file__).resolve().parents[1] / "datasets" / "t2rgb"
POSES = 10
"""Of its motion.json."""
# A board as large as t2rgb's, but of larger squares, and never far away: small images still show its markers.
CHANGES = {
    "robot.urdf": {},
    "config.yml": {
        "dimension: {x: 11, y: 8}": "dimension: {x: 7, y: 5}",
        " size: 0.06": " size: 0.09",
        "inner_size: 0.045": "inner_size: 0.0675",
    },
    "simulation.yml": {
        "width: 640, height: 480": "width: 320, height: 240",
        "xyz: [-0.06, 0.48, 0]": "xyz: [-0.09, 0.45, 0]",
        "distance_m: [1.2, 3.0]": "distance_m: [1.2, 1.8]",
    },
}


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder "small" of the system, with a motion, to be left as it is."""
    folder = tmp_path_factory.mktemp("system") / "small"
    folder.mkdir()
    for name, changes in CHANGES.items():
        text = (T2RGB / name).read_text()
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        (folder / name).write_text(text)
    motion = generate_motion(read_system(folder), POSES, 1)
    (folder / "motion.json").write_text(json.dumps(motion_document(motion)))
    return folder


def first_poses(system: Path, count: int, path: Path) -> Path:
    """Write the first poses of a system's motion to a file."""
    poses = json.loads((system / "motion.json").read_text())
    path.write_text(json.dumps({str(i): poses[str(i)] for i in range(1, count + 1)}))
    return path
