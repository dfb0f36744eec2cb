"""Tags on the sides of a body: a cube before two cameras, on an arm, and descriptions of sides."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.records import read
from calibration.engine.dataset.pattern import PlacedTag
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.rotations import to_rpy
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, local
from calibration.robot.importing.description import ImportDescription, with_sides
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.importing import import_data
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board, Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
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


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cube")
    photograph(folder, poses(10))
    return folder


def test_a_cube_in_a_hand_calibrates_two_cameras_to_the_truth(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (recorded / "import.yml").write_text(yaml.safe_dump(described()))
    import_data(recorded / "import.yml", tmp_path / "robot", jobs=1)
    dataset = read_dataset(tmp_path / "robot")
    assert dataset.moving_transforms == {("world", "cube")}
    assert all(pattern.known_pose and pattern.parent_link == "cube" for pattern in dataset.patterns.values())
    assert max(len({pattern for pattern, _ in each.labels}) for each in dataset.collections) >= 3
    found = calibrate(dataset, Options(description="rough"))
    error = local(found.dataset.transform("left_optical_frame", "right_optical_frame")[0], T_LEFT_RIGHT)
    assert np.linalg.norm(error[:3]) < 1e-3
    assert np.linalg.norm(error[3:]) < 1e-3
    covariance = found.covariances[dataset.sensors["right"].edge]
    assert error @ np.linalg.solve(covariance, error) < 22.5  # chi^2 of 6 at 1 in 1000
    for side in dataset.patterns.values():
        assert found.sigma_mm((side.parent_link, side.link)) == 0
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--dataset", "robot"]) == 0
    assert "rgb-to-rgb:left:right:cube_" in (tmp_path / "calibration.yml").read_text()


def test_a_cube_before_cameras_in_a_bag_is_the_same(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "recorded"
    with BagFile(path, "mcap") as bag:
        bag.transforms("/tf_static", BEGIN, {("world", "left"): np.eye(4), ("world", "right"): T_LEFT_RIGHT})
        for name in CAMERAS:
            bag.camera_info(f"/{name}/camera_info", BEGIN, name, (640, 480), VGA.fx, k=VGA.K.ravel())
            for i in range(5):
                shown = np.asarray(cv2.imread(str(recorded / name / f"{i}.png")))
                bag.image(f"/{name}/image_raw", BEGIN + i * SECOND, shown, name)
    document = {"bags": {"files": ["recorded"]}, "patterns": {"cube": CUBE}}
    (tmp_path / "import.yml").write_text(json.dumps(document))
    import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1)
    dataset = read_dataset(tmp_path / "out")
    assert (dataset.anchored, dataset.moving_transforms) == ("left", {("world", "cube")})
    error = local(calibrate(dataset, Options()).dataset.transform("left", "right")[0], T_LEFT_RIGHT)
    assert np.linalg.norm(error[:3]) < 2e-3


def test_tags_of_one_plane_are_one_side_and_all_are_where_they_were() -> None:
    turned = from_xyz_rpy([0.3, 0.1, 0.2], [0.4, 0.5, 0.6])
    places = [turned @ from_xyz_rpy(xyz, [0, 0, yaw]) for xyz, yaw in (((0, 0, 0), 0), ((0.2, -0.1, 0), 1.0))]
    tags = [{"id": i, "size": 0.1, **at(T)} for i, T in enumerate([*places, np.eye(4)])]
    document = {"sensors": {"left": {"images": "left"}}, "patterns": {"body": CUBE | {"tags": tags, "parent": "arm"}}}
    described_ = with_sides(read(ImportDescription, document, "import.yml"))
    assert [len(side.tags or ()) for side in described_.patterns] == [2, 1]
    assert [(body.name, body.parent, body.fixed) for body in described_.bodies] == [("body", "arm", True)]
    corners = [
        apply(side.pose.transform, pattern_configuration(side, "world").pattern().corners)
        for side in described_.patterns
        if side.pose is not None
    ]
    flat = PlacedTag(0, 0.1).corners
    expected = [apply(T, flat) for T in (*places, np.eye(4))]
    np.testing.assert_allclose(np.concatenate(corners), np.concatenate(expected), atol=1e-9)


def at(T: Array) -> dict[str, float]:
    """A tag's place in import.yml."""
    numbers = (*T[:3, 3].tolist(), *to_rpy(T[:3, :3]).tolist())
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))


def test_boards_on_a_body_have_known_poses_if_they_are_given(tmp_path: Path, recorded: Path) -> None:
    tags = {"type": "tags", "dictionary": "DICT_APRILTAG_36h11"}
    patterns = {
        "front": {**tags, "tags": [{"id": 0, "size": 0.15}], "parent": "box", "pose": {"xyz": [0, 0, -HALF]}},
        "side": {**tags, "tags": [{"id": 1, "size": 0.15}], "parent": "box", "fixed": True},
    }
    document = described() | {"bodies": {"box": {}}, "patterns": patterns}
    (recorded / "import.yml").write_text(yaml.safe_dump(document))
    import_data(recorded / "import.yml", tmp_path / "out", jobs=1)
    dataset = read_dataset(tmp_path / "out")
    assert {name: pattern.known_pose for name, pattern in dataset.patterns.items()} == {"front": True, "side": False}
    found = calibrate(dataset, Options(description="rough")).dataset.transform("front_link", "side_link")[0]
    true = from_xyz_rpy([-HALF, 0, HALF], [0, TURN, 0])
    assert np.linalg.norm(local(found, true)[:3]) < 2e-3


def test_a_pose_of_a_body_is_refused() -> None:
    with pytest.raises(InputError, match="found 'pose' of tags on several sides"):
        read(ImportDescription, described(pose={"xyz": [0, 0, 1]}), "import.yml")
