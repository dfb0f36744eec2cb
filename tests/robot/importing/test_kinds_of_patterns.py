"""Rendered folders with each kind of pattern: import, init, and a calibration to the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.base import InputError
from calibration.base.records import read
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import distance, from_xyz_rpy
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.importing import import_data
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board, Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.importing.conftest import camera_info
from tests.robot.labelling.pictures import VGA, facing

T_LEFT_RIGHT = from_xyz_rpy([0.2, 0.01, -0.02], [0.02, -0.15, 0.01])
CAMERAS = {"left": np.eye(4), "right": T_LEFT_RIGHT}
KINDS: dict[str, dict[str, Any]] = {
    "circles": {"type": "circles", "columns": 9, "rows": 6, "spacing": 0.05, "diameter": 0.03},
    "asymmetric-circles": {"type": "asymmetric-circles", "columns": 4, "rows": 11, "spacing": 0.03, "diameter": 0.024},
    "tags": {
        "type": "tags",
        "dictionary": "DICT_APRILTAG_36h11",
        "tags": [
            {"id": 7, "size": 0.12},
            {"id": 8, "size": 0.12, "x": 0.25, "y": 0.02, "yaw": 0.1},
            {"id": 30, "size": 0.1, "x": 0.1, "y": 0.2},
        ],
    },
    "one tag": {"type": "tags", "dictionary": "DICT_4X4_50", "tags": [{"id": 3, "size": 0.2}]},
}


def described_as(kind: str) -> dict[str, Any]:
    """An import.yml of two cameras and a pattern of a kind."""
    return {
        "sensors": {name: {"images": name, "intrinsics": "camera.yaml"} for name in CAMERAS},
        "patterns": {"board": KINDS[kind] | {"border": 0.02}},
    }


def views_of(kind: str, camera: str, count: int = 8) -> Iterator[Image]:
    """Rendered images of a pattern of a kind."""
    (described,) = read(ImportDescription, described_as(kind), "import.yml").patterns
    pattern = pattern_configuration(described, "world")
    for i in range(count):
        T_left_board = facing(pattern, 1.0, 0.5, 0.8 * i, 0.1 * i - 0.4, (0.1 - 0.02 * i, 0.05))
        board = Board(pattern, pattern.pattern(), T_left_board)
        yield SimulatedCamera(VGA).render(CAMERAS[camera], Scene(ground=-5.0), [board], stream(i))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("kind", KINDS)
def test_a_folder_is_imported_and_calibrated_to_the_truth(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "recorded"
    for name in CAMERAS:
        (folder / name).mkdir(parents=True)
        for i, image in enumerate(views_of(kind, name)):
            cv2.imwrite(str(folder / name / f"{i}.png"), image)
    info = camera_info(focal=VGA.fx)
    info["camera_matrix"]["data"] = [VGA.fx, 0, VGA.cx, 0, VGA.fy, VGA.cy, 0, 0, 1]
    (folder / "camera.yaml").write_text(yaml.safe_dump(info))
    (folder / "import.yml").write_text(yaml.safe_dump(described_as(kind)))

    import_data(folder / "import.yml", tmp_path / "robot", jobs=1)
    dataset = read_dataset(tmp_path / "robot" / "dataset.json")
    assert len(dataset.collections) == 8
    result = calibrate(dataset, Options())
    frames = [dataset.sensors[name].frame for name in CAMERAS]
    found = result.dataset.transform(*frames, np.array([0]))[0]
    metres, radians = distance(found, T_LEFT_RIGHT)
    assert metres < (0.0015 if kind == "one tag" else 0.0006)
    assert radians < (0.002 if kind == "one tag" else 0.0005)
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--dataset", "robot"]) == 0


def test_another_grid_of_circles_is_named(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    for i, image in enumerate(views_of("circles", "left", count=3)):
        cv2.imwrite(str(tmp_path / "left" / f"{i}.png"), image)
    wrong = {"type": "circles", "columns": 8, "rows": 7, "spacing": 0.05, "diameter": 0.03}
    document = {"sensors": {"left": {"images": "left"}}, "patterns": {"board": wrong}}
    (tmp_path / "import.yml").write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match="found circles, 9 x 6: are type, columns and rows"):
        import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1)
