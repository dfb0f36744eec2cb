"""Clouds of a LiDAR in files, beside the images of a camera."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import read_points
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.rotations import to_rpy
from calibration.engine.geometry.transforms import distance, inverse
from calibration.robot.importing.cloud_files import read_cloud
from calibration.robot.importing.importing import import_data
from tests.robot.importing.clouds import CLOUDS
from tests.robot.importing.conftest import BOARD, camera_info
from tests.robot.importing.test_lidars import RLBOT, with_truth

POINTS = np.random.default_rng(1).uniform(-20, 20, (500, 3)).round(3)
POINTS[100:200] = POINTS[100]  # repeated values, which compression finds


@pytest.mark.parametrize("name", CLOUDS)
def test_every_format_has_the_same_points(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(CLOUDS[name](POINTS))
    np.testing.assert_allclose(read_cloud(path), POINTS, atol=6e-6)


@pytest.mark.parametrize("name", CLOUDS)
def test_a_truncated_or_empty_file_is_one_line(tmp_path: Path, name: str) -> None:
    path, whole = tmp_path / name, CLOUDS[name](POINTS)
    for size in (0, 10, len(whole) // 2):
        path.write_bytes(whole[:size])
        if path.suffix in (".xyz", ".csv", ".pts", ".txt") and size > 10:
            continue  # a text that is cut between two lines is a smaller cloud
        with pytest.raises(InputError) as error:
            read_cloud(path)
        assert str(error.value).startswith(f"{path}: ")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xyz", b"1 2 3\n1 2\n", "no three numbers"),
        ("a.xyz", b"1 2 3\none two three\n", "no three numbers"),
        ("a.csv", b"x,y,z\n4000000,2,3\n", r"4e\+06 m.*not those of a map"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement face 3\nend_header\n", "no vertices"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n",
            "a type and a name",
        ),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
            "count of points",
        ),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no property 'y'"),
        ("a.laz", CLOUDS["new.LAS"](POINTS)[:104] + b"\x80" + CLOUDS["new.LAS"](POINTS)[105:], "LAZ"),
        ("a.las", CLOUDS["new.LAS"](POINTS)[:25] + b"\x07" + CLOUDS["new.LAS"](POINTS)[26:], "version 1.7"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_cloud(tmp_path / name)
    assert "\n" not in str(error.value)


def described(folder: Path, suffix: str, off: float) -> Path:
    """An import.yml of rlbot's images and clouds; the LiDAR's pose is told ``off`` m beside where it is."""
    dataset, _ = with_truth()
    camera, lidar = (dataset.sensors[name] for name in ("rgb_left", "lidar_right"))
    assert camera.camera is not None
    for kind in ("images", "clouds"):
        (folder / kind).mkdir()
    for key in dataset.keys:
        shutil.copy(RLBOT / f"rgb_left_{key}.jpg", folder / "images" / f"{key}.jpg")
        points = np.asarray(read_points(RLBOT / f"lidar_right_{key}.pcd"), float)
        (folder / "clouds" / f"{key}{Path(suffix).suffix}").write_bytes(CLOUDS[suffix](points))
    info = camera_info(camera.camera.width, camera.camera.height, camera.camera.fx)
    info["camera_matrix"]["data"][2::3] = [camera.camera.cx, camera.camera.cy, 1]
    (folder / "camera.yaml").write_text(json.dumps(info))
    T = inverse(dataset.transform("world", camera.frame)[0]) @ dataset.transform("world", lidar.frame)[0]
    pose = {"xyz": (T[:3, 3] + off).tolist(), "rpy": to_rpy(T[:3, :3]).tolist()}
    document = {
        "sensors": {
            "camera": {"images": "images", "intrinsics": "camera.yaml"},
            "lidar": {"clouds": "clouds", "pose": pose},
        },
        "patterns": {"board": BOARD},
    }
    (folder / "import.yml").write_text(json.dumps(document))
    return folder / "import.yml"


def test_a_camera_and_a_lidar_calibrate(tmp_path: Path) -> None:
    config = described(tmp_path, "compressed.pcd", off=0.03)
    results = import_data(config, tmp_path / "out", jobs=1)
    assert results.sensors["lidar"].labelled >= 0.8 * results.collections > 0
    calibrated = calibrate(read_dataset(tmp_path / "out"), Options()).dataset
    dataset, _ = with_truth()
    camera, lidar = (dataset.sensors[name].frame for name in ("rgb_left", "lidar_right"))
    expected = inverse(dataset.transform("world", camera)[0]) @ dataset.transform("world", lidar)[0]
    found = calibrated.transform("camera_optical_frame", "lidar_optical_frame")[0]
    metres, angle = distance(found, expected)
    assert metres < 0.02
    assert angle < 0.01


def test_without_its_pose_the_error_says_so(tmp_path: Path) -> None:
    config = described(tmp_path, "binary.pcd", off=3.0)
    with pytest.raises(InputError, match=r"'lidar' sees no pattern.*pose"):
        import_data(config, tmp_path / "out", jobs=1)
