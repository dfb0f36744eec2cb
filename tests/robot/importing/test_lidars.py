"""LiDARs in a bag: their points on the pattern are found where the camera sees it."""

from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import read_points
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.evaluation.truth import choose_truth
from calibration.engine.geometry.transforms import apply, distance, inverse, translation
from calibration.robot.importing.importing import import_data
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind
from tests.robot.importing.conftest import DATASETS
from tests.robot.importing.test_bags import describe, file_of
from tests.thorough import thorough

RLBOT = DATASETS / "rlbot"
SENSORS = {
    "camera": {"topic": "/rgb_left/image_raw", "parent": "tripod_left_support"},
    "lidar": {"topic": "/lidar", "parent": "tripod_right_support"},
}


def scan(T_lidar_pattern: Array, outline: Array) -> dict[str, Any]:
    """LaserScan of a LiDAR with a scan line on a board, and no other returns."""
    angles = np.arange(-0.6, 0.6, 0.002)
    rays = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    T = inverse(T_lidar_pattern)
    origin, directions = T[:3, 3], rays @ T[:3, :3].T
    ranges = -origin[2] / directions[:, 2]
    x, y = (origin + ranges[:, None] * directions)[:, :2].T
    inside = (x > outline[0, 0]) & (x < outline[2, 0]) & (y > outline[0, 1]) & (y < outline[2, 1]) & (ranges > 0)
    return {
        "angle_min": -0.6,
        "angle_max": 0.6,
        "angle_increment": 0.002,
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": 0.05,
        "range_max": 30.0,
        "ranges": np.where(inside, ranges, np.inf).tolist(),
        "intensities": [],
    }


def with_truth() -> tuple[Dataset, dict[str, Array]]:
    """rlbot with the true transforms, and the true ``T_world_pattern`` of each collection."""
    dataset = read_dataset(RLBOT)
    truth = choose_truth(dataset, None)
    assert truth is not None
    poses = {key: truth.patterns[key]["world", "pattern_link"] for key in dataset.keys}
    return dataset.with_transforms({edge: truth.transforms[edge] for edge in truth.sensors.values()}), poses


def record(
    folder: Path,
    kind: Kind,
    data: Literal["clouds", "livox", "scans"] = "clouds",
    moved: float = 0.0,
    turned: float = 0.0,
) -> Path:
    """rlbot's recording; the LiDAR is described ``moved`` m beside where it is."""
    path = file_of(folder, kind)
    dataset, poses = with_truth()
    camera = dataset.sensors["rgb_left"].camera
    assert camera is not None
    pattern = dataset.patterns["pattern_1"]
    edges = {edge: T[0] for edge, T in dataset.transforms.items() if edge[1] != pattern.link}
    lidar = dataset.sensors["lidar_right"]
    T_world_lidar = dataset.transform("world", lidar.frame)[0]
    edges[lidar.edge] = edges[lidar.edge] @ translation([moved, 0.0, turned])
    with BagFile(path, kind) as bag:
        bag.transforms("/tf_static", BEGIN, edges)
        for n, key in enumerate(dataset.keys):
            stamp, frame = BEGIN + n * SECOND, dataset.sensors["rgb_left"].frame
            bag.camera_info("/rgb_left/camera_info", stamp, frame, (camera.width, camera.height), camera.fx)
            shown = np.asarray(cv2.imread(str(RLBOT / f"rgb_left_{key}.jpg")))
            bag.image("/rgb_left/image_raw", stamp, shown, frame)
            if data != "scans":
                cloud = np.asarray(read_points(RLBOT / f"lidar_right_{key}.pcd"), float)
                write = bag.livox if data == "livox" else bag.cloud
                write("/lidar", stamp + SECOND // 20, cloud, lidar.frame)
            else:
                seen = scan(inverse(T_world_lidar) @ poses[key], pattern.outline)
                bag.scan("/lidar", stamp + SECOND // 20, seen, lidar.frame)
    return path


def imported(path: Path, output: Path) -> Dataset:
    board = {"type": "charuco", "columns": 11, "rows": 8, "square": 0.06, "marker": 0.045, "border": 0.035}
    patterns = {"board": {**board, "dictionary": "DICT_5X5_100"}}
    import_data(describe(path, sensors=SENSORS, patterns=patterns), output, jobs=1)
    return read_dataset(output)


def test_clouds_calibrate_to_the_truth(tmp_path: Path) -> None:
    dataset = imported(record(tmp_path, "bag", moved=0.03), tmp_path / "out")
    known, _ = with_truth()
    assert dataset.sensors["lidar"].edge == known.sensors["lidar_right"].edge
    for collection, other in zip(dataset.collections, known.collections, strict=True):
        ours, theirs = (
            each.labels.get(key)
            for each, key in ((collection, ("board", "lidar")), (other, ("pattern_1", "lidar_right")))
        )
        if isinstance(ours, PointLabels) and isinstance(theirs, PointLabels):
            assert abs(len(ours.points) - len(theirs.points)) <= 0.1 * len(theirs.points)
    found = calibrate(dataset, Options()).dataset
    true = known.transform("rgb_left_optical_frame", "lidar_right")[0]
    m, rad = (float(v) for v in distance(true, found.transform("rgb_left_optical_frame", "lidar_right")[0]))
    assert m < 0.005
    assert np.degrees(rad) < 0.3


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [thorough("bag"), "mcap"])
def test_clouds_of_livox_are_those_of_a_pointcloud(tmp_path: Path, kind: Kind) -> None:
    found = []
    for data in ("livox", "clouds"):
        (tmp_path / data).mkdir()
        found.append(imported(record(tmp_path / data, kind, data), tmp_path / data / "out"))
    for ours, theirs in zip(*(dataset.detections("board", "lidar") for dataset in found), strict=True):
        assert isinstance(ours[1], PointLabels)
        assert isinstance(theirs[1], PointLabels)
        np.testing.assert_allclose(ours[1].points, theirs[1].points, atol=1e-6)
    assert len(found[0].detections("board", "lidar")) >= 5


def test_scan_lines_on_the_board_are_labelled(tmp_path: Path) -> None:
    dataset = imported(record(tmp_path, "db3", "scans"), tmp_path / "out")
    assert dataset.sensors["lidar"].modality.name == "lidar2d"
    known, poses = with_truth()
    labelled = dataset.detections("board", "lidar")
    assert len(labelled) >= 5
    T_world_lidar = known.transform("world", "lidar_right")[0]
    for number, labels in labelled:
        assert isinstance(labels, PointLabels)
        on_board = apply(inverse(poses[known.keys[number]]) @ T_world_lidar, labels.points)
        assert np.abs(on_board[:, 2]).max() < 1e-3


def test_a_lidar_that_is_elsewhere_than_described(tmp_path: Path) -> None:
    path = record(tmp_path, "mcap", moved=2.0, turned=2.0)
    with pytest.raises(InputError, match=r"'lidar' sees no pattern at any of \d+ moments where a camera sees it"):
        imported(path, tmp_path / "out")
