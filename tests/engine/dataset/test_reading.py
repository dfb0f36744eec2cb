import base64
import gc
import json
import math
import subprocess
import sys

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.process import no_collector
from calibration.engine.dataset.configuration import parse_configuration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.modalities import LIDAR3D, RGB
from calibration.engine.dataset.model import CornerLabels, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import read_points
from calibration.engine.geometry.transforms import from_quaternion
from tests.engine.dataset import documents
from tests.engine.dataset.documents import CLOUD, MISSING, changed


@pytest.fixture
def dataset(tmp_path):
    return read_dataset(documents.write(tmp_path, documents.document()))


def read(folder, content):
    return read_dataset(documents.write(folder, content))


def test_a_folder_or_its_file(tmp_path):
    path = documents.write(tmp_path, documents.document())
    assert read_dataset(tmp_path).path == read_dataset(path).path == read_dataset(str(path)).path == path
    assert read_dataset(tmp_path).name == tmp_path.name


def test_collections_are_sorted_by_number_with_or_without_gaps(dataset):
    assert dataset.keys == ("000", "002")
    assert dataset.version == "3.0"
    assert dataset.world == "world"


def test_numbers_are_compared_as_numbers(tmp_path):
    content = documents.document()
    for key in ("10", "9"):
        content["collections"][key] = content["collections"]["002"]
    assert read(tmp_path, content).keys == ("000", "002", "9", "10")


def test_sensors(dataset):
    cam, lidar = dataset.sensors["cam"], dataset.sensors["lidar"]
    assert (cam.modality, cam.frame, cam.edge) == (RGB, "cam_optical", ("mount", "cam_link"))
    assert (lidar.modality, lidar.frame, lidar.edge) == (LIDAR3D, "lidar_frame", ("mount", "lidar_base"))
    assert lidar.camera is None
    assert (cam.camera.fx, cam.camera.fy, cam.camera.cx, cam.camera.cy) == (300, 301, 160.5, 120.5)
    assert (cam.camera.width, cam.camera.height) == (320, 240)
    d = cam.camera.distortion
    assert (d.k1, d.k2, d.p1, d.p2, d.k3) == (0.1, -0.2, 0.001, 0.002, 0.03)
    assert dataset.anchored == "lidar"
    assert dataset.additional_transforms == (("world", "mount"),)


@pytest.mark.parametrize("nothing", [None, "", MISSING])
def test_no_anchored_sensor(tmp_path, nothing):
    content = changed(documents.document(), {"calibration_config/anchored_sensor": nothing})
    assert read(tmp_path, content).anchored is None


@pytest.mark.parametrize("nothing", [None, {}, MISSING])
def test_no_additional_transforms(tmp_path, nothing):
    content = changed(documents.document(), {"calibration_config/additional_tfs": nothing})
    assert read(tmp_path, content).additional_transforms == ()


def test_labels_of_a_camera(dataset):
    whole, part = (collection.labels["board", "cam"] for collection in dataset.collections)
    assert isinstance(whole, CornerLabels)
    assert whole.ids.tolist() == [5, 4, 3, 2, 1, 0]  # as they stand in the file
    assert part.ids.tolist() == [0, 2, 5]
    np.testing.assert_array_equal(part.pixels, [[100.5, 80.25], [180.5, 80.25], [180.5, 120.25]])


def test_labels_of_a_lidar(dataset):
    labels = dataset.collections[0].labels["board", "lidar"]
    assert isinstance(labels, PointLabels)
    np.testing.assert_array_equal(labels.points, CLOUD[[1, 3, 4, 7]])
    assert labels.points.dtype == float
    assert labels.limits.tolist() == [1, 0, 3]  # points 3, 1 and 7 of the cloud
    assert ("board", "lidar") not in dataset.collections[1].labels
    assert [i for i, _ in dataset.detections("board", "lidar")] == [0]
    assert [i for i, _ in dataset.detections("board", "cam")] == [0, 1]


def test_what_is_not_detected_is_not_looked_at(tmp_path):
    """Its point cloud (none.pcd) does not even exist."""
    assert not (tmp_path / "none.pcd").exists()
    assert len(read(tmp_path, documents.document()).collections) == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"collections/002/labels/board/cam": MISSING},
        {"collections/002/labels/board": {}},
        {"collections/002/labels": {}},
        {"collections/002/labels/board/cam": {"detected": True, "idxs": []}},
        {"collections/002/labels/board/cam": {"detected": False}},
        {"collections/002/labels": {}, "collections/002/data": MISSING},
    ],
)
def test_a_collection_that_a_sensor_did_not_see(tmp_path, changes):
    dataset = read(tmp_path, changed(documents.document(), changes))
    assert dataset.keys == ("000", "002")
    assert dataset.collections[1].labels == {}


def test_a_limit_point_of_several(tmp_path):
    """Limits are found whatever the order of the points."""
    labels = {"detected": True, "idxs": [8, 0, 5], "idxs_limit_points": [0, 8]}
    dataset = read(tmp_path, changed(documents.document(), {"collections/000/labels/board/lidar": labels}))
    np.testing.assert_array_equal(dataset.collections[0].labels["board", "lidar"].points, CLOUD[[8, 0, 5]])
    assert dataset.collections[0].labels["board", "lidar"].limits.tolist() == [1, 0]


@pytest.mark.parametrize("as_text", [True, False])
def test_a_cloud_inside_the_document_wins(tmp_path, as_text):
    """A ROS message: big-endian, doubles, other fields in between, rows with something behind them."""
    points = np.arange(18, dtype=">f8").reshape(2, 3, 3)
    rows = np.full((2, 100), 7, np.uint8)
    for row, columns in zip(rows, points, strict=True):
        for i, point in enumerate(columns):
            row[32 * i + 8 : 32 * i + 32] = np.frombuffer(point[[2, 0, 1]].tobytes(), np.uint8)
    message = {
        "height": 2,
        "width": 3,
        "point_step": 32,
        "row_step": 100,
        "is_bigendian": True,
        "fields": [
            {"name": "ring", "offset": 0, "datatype": 4, "count": 1},
            {"name": "z", "offset": 8, "datatype": 8, "count": 1},
            {"name": "x", "offset": 16, "datatype": 8, "count": 1},
            {"name": "y", "offset": 24, "datatype": 8, "count": 1},
        ],
        "data": base64.b64encode(rows.tobytes()).decode() if as_text else rows.reshape(-1).tolist(),
        "data_file": "missing.pcd",
    }
    labels = {"detected": True, "idxs": [0, 4], "idxs_limit_points": []}
    changes = {"collections/000/data/lidar": message, "collections/000/labels/board/lidar": labels}
    dataset = read(tmp_path, changed(documents.document(), changes))
    np.testing.assert_array_equal(dataset.collections[0].labels["board", "lidar"].points, [[0, 1, 2], [12, 13, 14]])


def test_two_patterns_in_one_cloud(tmp_path):
    content = documents.document()
    config = content["calibration_config"]["calibration_patterns"]
    config["other"] = {**config["board"], "link": "other_link"}
    content["collections"]["000"]["labels"]["other"] = {
        "lidar": {"detected": True, "idxs": [0, 8], "idxs_limit_points": [8]},
        "cam": {"detected": True, "idxs": documents.corners(1, 2)},
    }
    dataset = read(tmp_path, content)
    assert list(dataset.patterns) == ["board", "other"]
    np.testing.assert_array_equal(dataset.collections[0].labels["other", "lidar"].points, CLOUD[[0, 8]])
    assert dataset.collections[0].labels["board", "cam"].ids.tolist() == [5, 4, 3, 2, 1, 0]
    assert dataset.collections[0].labels["other", "cam"].ids.tolist() == [1, 2]


def test_points_without_a_return_may_be_in_a_cloud_if_not_labelled(tmp_path):
    path = documents.write(tmp_path, documents.document())
    cloud = CLOUD.copy()
    cloud[0] = np.nan
    documents.write_points(tmp_path / "lidar_000.pcd", cloud)
    assert np.isfinite(read_dataset(path).collections[0].labels["board", "lidar"].points).all()


def test_transforms(dataset):
    assert list(dataset.transforms) == [
        ("world", "mount"),
        ("mount", "cam_link"),
        ("cam_link", "cam_optical"),
        ("mount", "lidar_base"),
        ("lidar_base", "lidar_frame"),
    ]
    T = dataset.transforms["mount", "cam_link"]
    assert T.shape == (2, 4, 4)
    np.testing.assert_allclose(T[1], from_quaternion([0.1, 0, 0], [0, 0, 0.6, 0.8]), atol=1e-15)


def test_the_way_between_two_frames_follows_the_tree_up_and_down(dataset):
    optical = from_quaternion([0, 0, 0], [0.5, -0.5, 0.5, -0.5])
    cam = from_quaternion([0.1, 0, 0], [0, 0, 0.6, 0.8])
    base = from_quaternion([-0.1, 0, 0.04], [0, 0, 0, 1])
    expected = np.linalg.inv(cam @ optical) @ base
    np.testing.assert_allclose(dataset.transform("cam_optical", "lidar_frame")[0], expected, atol=1e-15)
    back = dataset.transform("lidar_frame", "cam_optical")
    np.testing.assert_allclose(back[1], np.linalg.inv(expected), atol=1e-15)
    np.testing.assert_array_equal(dataset.transform("mount", "mount"), np.broadcast_to(np.eye(4), (2, 4, 4)))


def test_a_quaternion_that_is_nearly_of_length_1_is_normalised(tmp_path):
    quaternion = [0.0, 0.0, 0.6 * 1.0009, 0.8 * 1.0009]
    content = changed(documents.document(), {"collections/000/transforms/mount-cam_link/quat": quaternion})
    R = read(tmp_path, content).transforms["mount", "cam_link"][0, :3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)


def test_a_transform_that_some_collections_lack_is_nan_there(tmp_path):
    content = documents.document()
    content["collections"]["002"]["transforms"] |= documents.edge("world", "board_link", [2.0, 0.0, 1.0])
    content["collections"]["002"]["transforms"] |= documents.edge("mount", "lamp", [0.0, 0.0, 1.0])
    dataset = read(tmp_path, content)
    T = dataset.transforms["world", "board_link"]
    assert np.isnan(T[0]).all()
    np.testing.assert_array_equal(T[1, :3, 3], [2, 0, 1])
    with pytest.raises(InputError, match="collections/000/transforms: no 'world-board_link'"):
        dataset.transform("cam_optical", "board_link")
    np.testing.assert_array_equal(dataset.transform("world", "board_link", np.array([1, 1])), T[[1, 1]])
    with pytest.raises(InputError, match="collections/000/transforms: no 'world-board_link'"):
        dataset.transform("cam_optical", "board_link", np.array([1, 0]))
    np.testing.assert_array_equal(dataset.with_collections([1]).transform("world", "board_link"), T[1:])


def test_patterns_are_generated(dataset):
    board = dataset.patterns["board"]
    assert (board.link, board.parent_link, board.fixed, board.kind) == ("board_link", "world", False, "charuco")
    expected = [[x, y, 0] for y in (0.1, 0.2) for x in (0.1, 0.2, 0.3)]
    np.testing.assert_allclose(board.corners, expected, atol=1e-15)
    expected = [[-0.02, -0.01], [0.42, -0.01], [0.42, 0.31], [-0.02, 0.31]]
    np.testing.assert_allclose(board.outline, expected, atol=1e-15)


def test_a_chessboards_origin_is_its_first_corner(tmp_path):
    pattern = "calibration_config/calibration_patterns/board"
    changes = {f"{pattern}/pattern_type": "chessboard", f"{pattern}/border_size": 0.05, f"{pattern}/inner_size": None}
    board = read(tmp_path, changed(documents.document(), changes)).patterns["board"]
    np.testing.assert_allclose(board.corners[4], [0.1, 0.1, 0], atol=1e-15)
    np.testing.assert_allclose(board.outline[[0, 2]], [[-0.15, -0.15], [0.35, 0.25]], atol=1e-15)


def test_an_aprilgrid_is_numbered_as_kalibr_does(tmp_path):
    """Kalibr's own formula, of a grid of twice as many corners as tags; y and z point the other way here."""
    pattern = "calibration_config/calibration_patterns/board"
    changes = {f"{pattern}/pattern_type": "aprilgrid", f"{pattern}/dictionary": None, f"{pattern}/spacing": 0.3}
    content = changed(documents.document(), changes)
    board = read(tmp_path, content).patterns["board"]
    assert len(board.corners) == 4 * 3 * 2
    for number, corner in enumerate(board.corners):
        row, column = divmod(number, 6)
        x, y = (i // 2 * (1 + 0.3) * 0.1 + i % 2 * 0.1 for i in (column, row))
        np.testing.assert_allclose(corner, [x, -y, 0], atol=1e-15)
    # tags and gaps, a gap more around them, and the border
    expected = [[-0.05, -0.27], [0.41, -0.27], [0.41, 0.04], [-0.05, 0.04]]
    np.testing.assert_allclose(board.outline, expected, atol=1e-12)
    again = parse_configuration(Node("here", (), content["calibration_config"]))
    assert again.patterns["board"].dictionary == "DICT_APRILTAG_36h11"
    assert parse_configuration(Node("here", (), again.to_document())) == again


@pytest.mark.parametrize(
    ("changes", "corners"),
    [
        ({"pattern_type": "circles"}, [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0, 0.1, 0]]),
        ({"pattern_type": "asymmetric-circles"}, [[0, 0, 0], [0.2, 0, 0], [0.4, 0, 0], [0.1, 0.1, 0]]),
        (
            {
                "pattern_type": "tags",
                "dictionary": "DICT_4X4_50",
                "tags": [{"id": 3, "size": 0.2}, {"id": 1, "size": 0.1, "x": 1.0, "y": 2.0, "yaw": math.pi / 2}],
            },
            [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0], [1.05, 1.95, 0], [1.05, 2.05, 0]],
        ),
    ],
)
def test_circles_and_tags(tmp_path, changes, corners):
    """As OpenCV numbers them; a configuration is written as it was read."""
    pattern = "calibration_config/calibration_patterns/board"
    content = changed(documents.document(), {f"{pattern}/{key}": value for key, value in changes.items()})
    if len(corners) < 6:
        board = read(tmp_path, content).patterns["board"]
        np.testing.assert_allclose(board.corners[:4], corners, atol=1e-15)
    again = parse_configuration(Node("here", (), content["calibration_config"]))
    np.testing.assert_allclose(again.patterns["board"].pattern().corners[: len(corners)], corners, atol=1e-15)
    assert parse_configuration(Node("here", (), again.to_document())) == again


def test_explicit_geometry_wins(tmp_path):
    content = documents.document()
    corners = [{"id": i, "x": 0.01 * i, "y": 0.5} for i in (3, 1, 2, 0, 5, 4)]
    names = ("top_left", "top_right", "bottom_right", "bottom_left")
    content["patterns"] = {
        "board": {"corners": corners, "frame": {"corners": {n: {"x": i, "y": -i} for i, n in enumerate(names)}}},
        "of another configuration": {},
    }
    board = read(tmp_path, content).patterns["board"]
    np.testing.assert_allclose(board.corners, [[0.01 * i, 0.5, 0] for i in range(6)])
    np.testing.assert_array_equal(board.outline, [[0, 0], [1, -1], [2, -2], [3, -3]])


@pytest.mark.parametrize(
    "patterns", [None, {}, {"board": None}, {"board": {}}, {"board": {"corners": [], "frame": {}}}]
)
def test_geometry_that_is_missing_is_generated(tmp_path, patterns, dataset):
    (tmp_path / "other").mkdir()
    board = read(tmp_path / "other", {**documents.document(), "patterns": patterns}).patterns["board"]
    np.testing.assert_array_equal(board.corners, dataset.patterns["board"].corners)
    np.testing.assert_array_equal(board.outline, dataset.patterns["board"].outline)


def test_version_2(tmp_path):
    dataset = read(tmp_path, documents.version_2())
    assert dataset.version == "2.0"
    assert list(dataset.patterns) == ["pattern_1"]
    assert dataset.anchored is None
    np.testing.assert_allclose(dataset.patterns["pattern_1"].corners[4], [0.1, 0.1, 0], atol=1e-15)
    np.testing.assert_allclose(dataset.patterns["pattern_1"].outline[0], [-0.12, -0.11], atol=1e-15)
    assert dataset.collections[1].labels["pattern_1", "cam"].ids.tolist() == [0, 2, 5]


@pytest.mark.parametrize("version", ["3.0", "3", 3, 3.0, "3.1"])
def test_version_numbers(tmp_path, version):
    assert read(tmp_path, changed(documents.document(), {"_metadata/version": version})).version == "3.0"


@pytest.mark.parametrize(
    ("model", "D", "expected"),
    [
        ("plumb_bob", [0.1, 0.2], (0.1, 0.2, 0, 0, 0)),
        ("plumb_bob", [], (0, 0, 0, 0, 0)),
        ("", [0, 0, 0, 0, 0], (0, 0, 0, 0, 0)),
        ("", [], (0, 0, 0, 0, 0)),
    ],
)
def test_fewer_coefficients_are_padded(tmp_path, model, D, expected):
    info = "sensors/cam/camera_info"
    content = changed(documents.document(), {f"{info}/distortion_model": model, f"{info}/D": D})
    d = read(tmp_path, content).sensors["cam"].camera.distortion
    assert (d.k1, d.k2, d.p1, d.p2, d.k3) == expected


@pytest.mark.parametrize("value", [{"id": 0.0}, {"x": 100}])
def test_any_number_will_do(tmp_path, value):
    """JSON does not tell 0 from 0.0."""
    content = documents.document()
    content["collections"]["002"]["labels"]["board"]["cam"]["idxs"][0].update(value)
    content["collections"]["000"]["transforms"]["world-mount"].update(trans=[0, 1, 2], quat=[0, 0, 0, 1])
    content["collections"]["000"]["labels"]["board"]["lidar"]["idxs"][0] = 1.0
    dataset = read(tmp_path, content)
    assert dataset.collections[1].labels["board", "cam"].ids.tolist() == [0, 2, 5]
    assert dataset.transforms["world", "mount"][0, :3, 3].tolist() == [0, 1, 2]
    assert dataset.collections[0].labels["board", "lidar"].limits.tolist() == [1, 0, 3]


def test_a_byte_order_mark_is_accepted_and_a_repeated_key_is_not(tmp_path):
    path = documents.write(tmp_path, documents.document())
    text = path.read_bytes()
    path.write_bytes(b"\xef\xbb\xbf" + text)
    assert read_dataset(path).version == "3.0"
    path.write_bytes(text.replace(b'{"_metadata"', b'{"_metadata": 5, "_metadata"', 1))
    with pytest.raises(InputError, match="the key '_metadata' occurs twice"):
        read_dataset(path)


def test_a_symbolic_link_inside_the_folder_is_followed(tmp_path):
    path = documents.write(tmp_path, documents.document())
    (tmp_path / "clouds").mkdir()
    (tmp_path / "lidar_000.pcd").rename(tmp_path / "clouds" / "a.pcd")
    (tmp_path / "lidar_000.pcd").symlink_to("clouds/a.pcd")
    assert ("board", "lidar") in read_dataset(path).collections[0].labels
    (tmp_path / "lidar_000.pcd").unlink()
    content = changed(documents.document(), {"collections/000/data/lidar/data_file": "clouds/a.pcd"})
    path.write_text(json.dumps(content))
    assert ("board", "lidar") in read_dataset(path).collections[0].labels


def test_nothing_can_be_changed(dataset):
    labels = dataset.collections[0].labels
    for array in (
        dataset.transforms["world", "mount"],
        labels["board", "cam"].ids,
        labels["board", "cam"].pixels,
        labels["board", "lidar"].points,
        labels["board", "lidar"].limits,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_with_transforms_gives_another_dataset(dataset):
    before = {edge: T.copy() for edge, T in dataset.transforms.items()}
    moved = from_quaternion([1, 2, 3], [0, 0, 0, 1])
    other = dataset.with_transforms({("mount", "cam_link"): moved, ("world", "board_link"): np.stack([moved, moved])})
    assert list(dataset.transforms) == list(before)
    for edge, T in before.items():
        np.testing.assert_array_equal(dataset.transforms[edge], T)
    np.testing.assert_array_equal(other.transforms["mount", "cam_link"], [moved, moved])
    np.testing.assert_array_equal(other.transform("world", "board_link")[1], moved)
    assert "board_link" not in dataset.tree
    assert other.transforms["world", "mount"] is dataset.transforms["world", "mount"]


def test_with_collections_gives_another_dataset(dataset):
    other = dataset.with_collections([1])
    assert other.keys == ("002",)
    assert other.transform("world", "cam_optical").shape == (1, 4, 4)
    assert dataset.keys == ("000", "002")


def test_the_garbage_collector_is_left_as_it_was(tmp_path):
    path = documents.write(tmp_path, documents.document())
    with no_collector():
        assert not gc.isenabled()
    assert gc.isenabled()
    read_dataset(path)
    assert gc.isenabled()
    gc.disable()
    try:
        read_dataset(path)
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_reading_needs_nothing_heavier_than_numpy():
    """Nor what the configuration's YAML needs: the import is on the way of every command."""
    code = "import sys, calibration.engine.dataset.reading; print([m for m in sys.modules if '.' not in m])"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for heavy in ("yaml", "jsonschema", "scipy", "cv2", "click", "rich"):
        assert f"'{heavy}'" not in modules


def test_the_papers_dataset(shared_data):
    dataset = read_dataset(shared_data / "t2rgb-paper")
    assert (dataset.version, len(dataset.collections), dataset.anchored) == ("2.0", 22, None)
    seen = [len(dataset.detections("pattern_1", sensor)) for sensor in ("left_camera", "right_camera")]
    assert seen == [17, 17]
    assert sum(len(collection.labels) == 2 for collection in dataset.collections) == 12 + 4
    # The cameras are 0.385 m apart, side by side.
    T = dataset.transform("camera_left_rgb_optical_frame", "camera_right_rgb_optical_frame")
    np.testing.assert_allclose(T[:, :3, 3], np.broadcast_to([0.385, 0, 0], (22, 3)), atol=1e-9)
    np.testing.assert_allclose(dataset.patterns["pattern_1"].outline[[0, 2]], [[-0.1, -0.09], [0.7, 0.51]])


@pytest.mark.parametrize("name", ["t2rgb", "riwbot", "rlbot"])
def test_the_corners_of_the_synthetic_datasets_match_the_truth(shared_data, name):
    """Noise of 0.3 px: tree, cameras, patterns, labels and truth fit together."""
    dataset = read_dataset(shared_data / "synthetic" / name)
    truth = json.loads((shared_data / "synthetic" / name / "ground_truth.json").read_text())["patterns"]
    residuals = []
    for i, collection in enumerate(dataset.collections):
        pose = truth[collection.key]
        T_world_pattern = from_quaternion(pose["trans"], pose["quat"])
        for (pattern, name_), labels in collection.labels.items():
            sensor = dataset.sensors[name_]
            corners = dataset.patterns[pattern].corners
            T = np.linalg.inv(dataset.transform("world", sensor.frame)[i]) @ T_world_pattern
            if isinstance(labels, CornerLabels):
                points = corners[labels.ids] @ T[:3, :3].T + T[:3, 3]
                residuals.append(sensor.camera.project(points) - labels.pixels)
            else:
                distance = (labels.points - T[:3, 3]) @ T[:3, 2]
                assert distance.std() < 0.015
    assert 0.28 < np.concatenate(residuals).std() < 0.32


def test_point_labels_are_the_clouds_points(shared_data):
    dataset = read_dataset(shared_data / "synthetic" / "rlbot")
    for collection in dataset.collections:
        if labels := collection.labels.get(("pattern_1", "lidar_right")):
            raw = dataset.document["collections"][collection.key]["labels"]["pattern_1"]["lidar_right"]
            cloud = read_points(shared_data / "synthetic" / "rlbot" / f"lidar_right_{collection.key}.pcd")
            np.testing.assert_array_equal(labels.points, cloud[raw["idxs"]])
            np.testing.assert_array_equal(labels.points[labels.limits], cloud[raw["idxs_limit_points"]])
