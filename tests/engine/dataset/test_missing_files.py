"""Missing point clouds and depth images: reported, and an error only if they are needed."""

import json
import shutil
from pathlib import Path

import pytest

from calibration.base import InputError, UndeterminedError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.diagnosis.diagnose import missing_files
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.evaluation.specification import parse_evaluation
from tests.pipeline.conftest import DATASETS

LIDAR_EDGE = ("lidar3d_plate_link", "lidar3d_base_link")


def softbot(folder: Path, *gone: str) -> Path:
    """Two cameras and a LiDAR, without their images and without some clouds."""
    path = folder / "softbot"
    shutil.copytree(DATASETS / "softbot", path, ignore=shutil.ignore_patterns("*.jpg", "*.png", *gone))
    return path


def anchor(path: Path, sensor: str) -> None:
    document = json.loads((path / "dataset.json").read_text())
    document["calibration_config"]["anchored_sensor"] = sensor
    (path / "dataset.json").write_text(json.dumps(document))


def test_the_other_sensors_are_evaluated_and_calibrated(tmp_path: Path) -> None:
    whole = read_dataset(DATASETS / "softbot")
    dataset = read_dataset(softbot(tmp_path, "*.pcd"))
    assert list(dataset.sensors) == ["front_left_camera", "front_right_camera"]
    assert dataset.missing_files == {"lidar3d": tuple(f"lidar3d_{key}.pcd" for key in whole.keys)}
    table = parse_evaluation("rgb-to-rgb:front_right_camera:front_left_camera")
    assert table.run(dataset).to_csv() == table.run(whole).to_csv()
    calibration = calibrate(dataset)
    assert calibration.converged
    assert LIDAR_EDGE not in calibration.transforms
    assert (calibration.dataset.transforms[LIDAR_EDGE] == whole.transforms[LIDAR_EDGE]).all()


def test_the_sensors_table_names_its_missing_files(tmp_path: Path) -> None:
    dataset = read_dataset(softbot(tmp_path, "*.pcd"))
    with pytest.raises(InputError, match=r"14 data files of sensor 'lidar3d' not found: lidar3d_000.pcd, .* 11 more"):
        parse_evaluation("lidar-to-rgb:lidar3d:front_left_camera").run(dataset)


def test_some_clouds_cost_their_views_alone(tmp_path: Path) -> None:
    dataset = read_dataset(softbot(tmp_path, "lidar3d_000.pcd", "lidar3d_003.pcd"))
    seen = [dataset.keys[i] for i, _ in dataset.detections("pattern_1", "lidar3d")]
    assert seen == [key for key in dataset.keys if key not in ("000", "003")]
    found, *others = missing_files(calibrate(dataset).dataset)
    assert not others
    assert (found.severity, found.sensors, found.value) == ("warning", ("lidar3d",), 2.0)
    assert found.text == (
        "2 data files of sensor 'lidar3d' not found: lidar3d_000.pcd, lidar3d_003.pcd; its labels in these are left out"
    )


def test_an_anchored_sensor_without_data_anchors_nothing_and_is_written_as_it_was(tmp_path: Path) -> None:
    path = softbot(tmp_path, "*.pcd")
    anchor(path, "lidar3d")
    dataset = read_dataset(path)
    assert dataset.anchored is None
    assert calibrate(dataset).gauge == "front_left_camera"
    written = json.loads(write_dataset(dataset, tmp_path / "out").read_text())
    assert written["calibration_config"]["anchored_sensor"] == "lidar3d"
    assert "lidar3d" in written["sensors"]


def test_nothing_left_is_an_error_that_names_the_files(tmp_path: Path) -> None:
    path = softbot(tmp_path, "*.pcd")
    document = json.loads((path / "dataset.json").read_text())
    for collection in document["collections"].values():
        for sensor in ("front_left_camera", "front_right_camera"):
            collection["labels"]["pattern_1"][sensor] = {"detected": False, "idxs": []}
    (path / "dataset.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"no label is left: 14 data files of sensor 'lidar3d' not found"):
        read_dataset(path)


def test_data_that_need_missing_files_are_refused(tmp_path: Path) -> None:
    shutil.copytree(DATASETS / "rlbot", tmp_path / "rlbot", ignore=shutil.ignore_patterns("*.jpg", "*.pcd"))
    with pytest.raises(UndeterminedError, match=r"a single sensor needs a robot .*; \d+ data files of sensor 'lidar_"):
        calibrate(read_dataset(tmp_path / "rlbot"))
