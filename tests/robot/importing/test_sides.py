"""Tags on the sides of a body: a cube before two cameras, on an arm, and descriptions of sides."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from calibration.base.arrays import Array
from calibration.base.records import read
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import from_xyz_rpy, local
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.patterns.sides import with_sides
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.importing.conftest import camera_info
from tests.robot.labelling.pictures import VGA

HALF, TURN = 0.1, np.pi / 2
CUBE: dict[str, Any] = {
    "type": "tags",
    "dictionary": "DICT_APRILTAG_36h11",
    "border": 0.025,
    "tags": [
        {"id": 0, "size": 0.15, "z": -HALF},
        {"id": 1, "size": 0.15, "x": -HALF, "pitch": TURN},
        {"id": 2, "size": 0.15, "x": HALF, "pitch": -TURN},
        {"id": 3, "size": 0.15, "y": HALF, "roll": TURN},
        {"id": 4, "size": 0.15, "y": -HALF, "roll": -TURN},
    ],
}
T_LEFT_RIGHT = from_xyz_rpy([0.2, 0.01, -0.02], [0.02, -0.15, 0.01])
CAMERAS = {"left": np.eye(4), "right": T_LEFT_RIGHT}


def described(**more: Any) -> dict[str, Any]:
    return {
        "sensors": {name: {"images": name, "intrinsics": "camera.yaml"} for name in CAMERAS},
        "patterns": {"cube": CUBE | more},
    }


def photograph(folder: Path, T_left_cube: list[Array]) -> None:
    """Images of the cube by both cameras."""
    sides = with_sides(read(ImportDescription, described(), "import.yml")).patterns
    for name, T_left_camera in CAMERAS.items():
        (folder / name).mkdir(parents=True)
        for i, T in enumerate(T_left_cube):
            boards = []
            for side in sides:
                pattern = pattern_configuration(side, "world")
                assert side.pose is not None
                boards.append(Board(pattern, pattern.pattern(), T @ side.pose.transform))
            image = SimulatedCamera(VGA).render(T_left_camera, Scene(ground=-5.0), boards, stream(i))
            cv2.imwrite(str(folder / name / f"{i}.png"), image)
    info = camera_info(focal=VGA.fx)
    info["camera_matrix"]["data"] = [VGA.fx, 0, VGA.cx, 0, VGA.fy, VGA.cy, 0, 0, 1]
    (folder / "camera.yaml").write_text(yaml.safe_dump(info))


def poses(count: int) -> list[Array]:
    random = np.random.default_rng(0)
    places = random.uniform([-0.1, -0.1, 0.7], [0.2, 0.1, 1.0], (count, 3))
    return [from_xyz_rpy(xyz, rpy) for xyz, rpy in zip(places, random.uniform(-0.7, 0.7, (count, 3)), strict=True)]


def test_a_cube_in_a_hand_calibrates_two_cameras_to_the_truth(tmp_path: Path) -> None:
    photograph(tmp_path, poses(10))
    (tmp_path / "import.yml").write_text(yaml.safe_dump(described()))
    import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1)
    dataset = read_dataset(tmp_path / "out")
    assert dataset.moving_transforms == {("world", "cube")}
    assert all(pattern.known_pose and pattern.parent_link == "cube" for pattern in dataset.patterns.values())
    assert max(len({pattern for pattern, _ in each.labels}) for each in dataset.collections) >= 3
    found = calibrate(dataset, Options(description="rough"))
    error = local(found.dataset.transform("left_optical_frame", "right_optical_frame")[0], T_LEFT_RIGHT)
    assert np.linalg.norm(error[:3]) < 1e-3
    assert np.linalg.norm(error[3:]) < 1e-3
    covariance = found.covariances[dataset.sensors["right"].edge]
    assert error @ np.linalg.solve(covariance, error) < 22.5  # chi^2 of 6 at 1 in 1000
