"""Every kind of invalid input is an error of one line: location, value found, value expected."""

import base64
import json
import os

import numpy as np
import pytest

from calibration.base import ExitCode, InputError
from calibration.engine.dataset.document import MAX_BYTES
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import write_points
from tests.engine.dataset import documents
from tests.engine.dataset.documents import CLOUD, MISSING, changed

NAN, INFINITY, HUGE = float("nan"), float("inf"), 10**400
FIRST, SECOND = "collections/000", "collections/002"
CAM, LIDAR = f"{FIRST}/labels/board/cam", f"{FIRST}/labels/board/lidar"
CONFIG = "calibration_config"
PATTERN = f"{CONFIG}/calibration_patterns/board"
TAGGED = {f"{PATTERN}/pattern_type": "aprilgrid", f"{PATTERN}/dictionary": None}
INFO = "sensors/cam/camera_info"
EDGE = f"{SECOND}/transforms/mount-cam_link"


def refused(path) -> str:
    """The message of a dataset that must not be read."""
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert caught.value.exit_code == ExitCode.BAD_INPUT == 2
    message = str(caught.value)
    assert message.isprintable()  # so it is one line
    assert message.startswith(str(path))
    return message.removeprefix(f"{path}: ")


# What is changed in the valid document, and the message without the file.
CASES = [
    # keys that are missing
    ({"_metadata": MISSING}, "missing key '_metadata'"),
    ({"_metadata/version": MISSING}, "_metadata: missing key 'version'"),
    ({CONFIG: MISSING}, "missing key 'calibration_config'"),
    ({"sensors": MISSING}, "missing key 'sensors'"),
    ({"collections": MISSING}, "missing key 'collections'"),
    ({f"{CONFIG}/world_link": MISSING}, "calibration_config: missing key 'world_link'"),
    ({f"{CONFIG}/sensors": MISSING}, "calibration_config: missing key 'sensors'"),
    ({f"{CONFIG}/calibration_patterns": MISSING}, "calibration_config: missing key 'calibration_patterns'"),
    ({f"{CONFIG}/sensors/cam/link": MISSING}, "calibration_config/sensors/cam: missing key 'link'"),
    ({f"{PATTERN}/dimension": MISSING}, f"{PATTERN}: missing key 'dimension'"),
    ({f"{PATTERN}/dimension/y": MISSING}, f"{PATTERN}/dimension: missing key 'y'"),
    ({f"{PATTERN}/pattern_type": "circles", f"{PATTERN}/inner_size": MISSING}, f"{PATTERN}: missing key 'inner_size'"),
    ({f"{PATTERN}/pattern_type": "tags"}, f"{PATTERN}: missing key 'tags'"),
    ({f"{PATTERN}/pattern_type": "tags", f"{PATTERN}/tags": [{"id": 1}]}, f"{PATTERN}/tags: tag 0: missing key 'size'"),
    ({f"{PATTERN}/fixed": MISSING}, f"{PATTERN}: missing key 'fixed'"),
    ({"sensors/cam/parent": MISSING}, "sensors/cam: missing key 'parent'"),
    ({INFO: MISSING}, "sensors/cam: missing key 'camera_info'"),
    ({f"{INFO}/K": MISSING}, f"{INFO}: missing key 'K'"),
    ({f"{INFO}/D": MISSING}, f"{INFO}: missing key 'D'"),
    ({f"{INFO}/distortion_model": MISSING}, f"{INFO}: missing key 'distortion_model'"),
    ({f"{INFO}/width": MISSING}, f"{INFO}: missing key 'width'"),
    ({f"{FIRST}/transforms": MISSING}, f"{FIRST}: missing key 'transforms'"),
    ({f"{FIRST}/labels": MISSING}, f"{FIRST}: missing key 'labels'"),
    ({f"{EDGE}/parent": MISSING}, f"{EDGE}: missing key 'parent'"),
    ({f"{EDGE}/trans": MISSING}, f"{EDGE}: missing key 'trans'"),
    ({f"{EDGE}/quat": MISSING}, f"{EDGE}: missing key 'quat'"),
    ({f"{CAM}/detected": MISSING}, f"{CAM}: missing key 'detected'"),
    ({f"{CAM}/idxs": MISSING}, f"{CAM}: missing key 'idxs'"),
    ({f"{CAM}/idxs/4/y": MISSING}, f"{CAM}/idxs/4: missing key 'y'"),
    ({f"{LIDAR}/idxs_limit_points": MISSING}, f"{LIDAR}: missing key 'idxs_limit_points'"),
    ({f"{FIRST}/data": MISSING}, f"{FIRST}: missing key 'data'"),
    ({f"{FIRST}/data/lidar": MISSING}, f"{FIRST}/data: missing key 'lidar'"),
    ({f"{FIRST}/data/lidar/data_file": MISSING}, f"{FIRST}/data/lidar: missing key 'data_file'"),
    # wrong types
    ({"_metadata": []}, "_metadata: found an empty list, expected an object"),
    ({"_metadata/version": None}, "_metadata/version: found null, expected version 2.0 or 3.0"),
    ({"_metadata/version": "4.0"}, "_metadata/version: found '4.0', expected version 2.0 or 3.0"),
    ({"_metadata/version": True}, "_metadata/version: found true, expected version 2.0 or 3.0"),
    ({CONFIG: 5}, "calibration_config: found 5, expected an object"),
    ({f"{CONFIG}/world_link": None}, f"{CONFIG}/world_link: found null, expected text"),
    ({f"{CONFIG}/world_link": ""}, f"{CONFIG}/world_link: found '', expected a name"),
    ({f"{CONFIG}/anchored_sensor": ["cam"]}, f"{CONFIG}/anchored_sensor: found a list of 1, expected text"),
    ({f"{CONFIG}/additional_tfs": [1]}, f"{CONFIG}/additional_tfs: found a list of 1, expected an object"),
    ({f"{CONFIG}/joints": "all"}, f"{CONFIG}/joints: found 'all', expected an object"),
    (
        {f"{CONFIG}/max_duration_between_msgs": "1 s"},
        "max_duration_between_msgs: found '1 s', expected a finite number",
    ),
    ({f"{PATTERN}/fixed": "no"}, f"{PATTERN}/fixed: found 'no', expected true or false"),
    ({f"{PATTERN}/dimension/x": 3.5}, f"{PATTERN}/dimension/x: found 3.5, expected a whole number from 2 to 1000"),
    ({f"{PATTERN}/dimension/x": 10**9}, f"{PATTERN}/dimension/x: found 1000000000, expected a whole number from 2 to"),
    ({f"{PATTERN}/dimension/x": 1}, f"{PATTERN}/dimension/x: found 1, expected a whole number from 2 to 1000"),
    ({f"{PATTERN}/size": 0}, f"{PATTERN}/size: found 0, expected a number from 1e-06 to 1000"),
    ({f"{PATTERN}/size": NAN}, f"{PATTERN}/size: found nan, expected a finite number"),
    ({f"{PATTERN}/inner_size": 0.1}, f"{PATTERN}/inner_size: found 0.1, expected less than the size of a square, 0.1"),
    ({f"{PATTERN}/border_size/x": -1}, f"{PATTERN}/border_size/x: found -1, expected a number from 0 to 1000"),
    ({f"{PATTERN}/border_size": "1"}, f"{PATTERN}/border_size: found '1', expected a finite number"),
    (
        {f"{PATTERN}/pattern_type": "dots"},
        f"{PATTERN}/pattern_type: found 'dots', expected one of charuco, chessboard, ",
    ),
    (TAGGED, f"{PATTERN}: missing key 'spacing'"),
    ({**TAGGED, f"{PATTERN}/spacing": 30}, f"{PATTERN}/spacing: found 30, expected a number from 0.01 to 1"),
    (
        {**TAGGED, f"{PATTERN}/dimension/x": 300},
        f"{PATTERN}/dimension: found 300 x 2 tags, expected 587 at most, as DICT",
    ),
    (
        {**TAGGED, f"{PATTERN}/dictionary": "DICT_4X4_50"},
        f"{PATTERN}/dictionary: found 'DICT_4X4_50', expected DICT_APR",
    ),
    ({"collections": []}, "collections: found an empty list, expected an object"),
    ({FIRST: None}, f"{FIRST}: found null, expected an object"),
    ({f"{FIRST}/transforms": []}, f"{FIRST}/transforms: found an empty list, expected an object"),
    ({EDGE: [1, 2]}, f"{EDGE}: found a list of 2, expected an object"),
    ({f"{EDGE}/parent": 5}, f"{EDGE}/parent: found 5, expected text"),
    ({f"{EDGE}/child": ["cam_link"]}, f"{EDGE}/child: found a list of 1, expected text"),
    ({f"{EDGE}/trans": 5}, f"{EDGE}/trans: found 5, expected a list"),
    ({f"{EDGE}/trans": "abc"}, f"{EDGE}/trans: found 'abc', expected a list"),
    ({f"{EDGE}/trans": {"x": 1, "y": 2, "z": 3}}, f"{EDGE}/trans: found an object of 3 keys, expected a list"),
    ({f"{EDGE}/trans/1": 1e308}, f"{EDGE}/trans: found a frame that is more than 1e+09 m away, expected m"),
    ({f"{EDGE}/trans": [1, 2]}, f"{EDGE}/trans: found a list of 2, expected a list of 3 numbers"),
    ({f"{EDGE}/trans": [[1], 2, 3]}, f"{EDGE}/trans/0: found a list of 1, expected a finite number"),
    ({f"{EDGE}/quat": [0, 0, 0, 0, 1]}, f"{EDGE}/quat: found a list of 5, expected a list of 4 numbers"),
    ({f"{EDGE}/trans/1": "0.5"}, f"{EDGE}/trans/1: found '0.5', expected a finite number"),
    ({f"{EDGE}/trans/1": True}, f"{EDGE}/trans/1: found true, expected a finite number"),
    ({f"{EDGE}/trans/1": None}, f"{EDGE}/trans/1: found null, expected a finite number"),
    ({f"{FIRST}/labels": []}, f"{FIRST}/labels: found an empty list, expected an object"),
    ({f"{FIRST}/labels/board": []}, f"{FIRST}/labels/board: found an empty list, expected an object"),
    ({CAM: 1}, f"{CAM}: found 1, expected an object"),
    ({f"{CAM}/detected": 1}, f"{CAM}/detected: found 1, expected true or false"),
    ({f"{CAM}/idxs": {"0": 1}}, f"{CAM}/idxs: found an object of 1 keys, expected a list"),
    ({f"{CAM}/idxs": "no"}, f"{CAM}/idxs: found 'no', expected a list"),
    ({f"{CAM}/idxs/2": 7}, f"{CAM}/idxs/2: found 7, expected an object"),
    ({f"{CAM}/idxs/2": "id"}, f"{CAM}/idxs/2: found 'id', expected an object"),
    ({f"{CAM}/idxs/2/x": "7"}, f"{CAM}/idxs/2/x: found '7', expected a finite number"),
    ({f"{CAM}/idxs/4/id": True}, f"{CAM}/idxs/4/id: found true, expected a finite number"),
    ({f"{LIDAR}/idxs": 4}, f"{LIDAR}/idxs: found 4, expected a list"),
    ({f"{LIDAR}/idxs/1": "3"}, f"{LIDAR}/idxs/1: found '3', expected a finite number"),
    ({f"{LIDAR}/idxs/0": True}, f"{LIDAR}/idxs/0: found true, expected a finite number"),
    ({f"{LIDAR}/idxs_limit_points": None}, f"{LIDAR}/idxs_limit_points: found null, expected a list"),
    ({"transforms": 5}, "transforms: found 5, expected an object"),
    ({"patterns": [1]}, "patterns: found a list of 1, expected an object"),
    ({"patterns": {"board": 5}}, "patterns/board: found 5, expected an object"),
    ({"patterns": {"board": {"corners": {}}}}, "patterns/board/corners: found an empty object, expected a list"),
    ({"patterns": {"board": {"corners": [{"id": 0, "x": 1}]}}}, "patterns/board/corners/0: missing key 'y'"),
    ({"patterns": {"board": {"corners": [{"id": 1, "x": 1, "y": 1}]}}}, "patterns/board/corners: found other ids than"),
    ({"patterns": {"board": {"frame": 5}}}, "patterns/board/frame: found 5, expected an object"),
    (
        {"patterns": {"board": {"frame": {"corners": {"top_left": {"x": 1, "y": NAN}}}}}},
        "patterns/board/frame/corners/top_left/y: found nan, expected a finite number",
    ),
    (
        {"patterns": {"board": {"corners": [{"id": 0, "x": 1, "y": 1e7}]}}},
        "patterns/board/corners: found corner 0 more than 1e+06 m away",
    ),
    # intrinsics
    ({f"{INFO}/K/0": 0}, f"{INFO}/K: found [0, 0.0, 160.5, 0.0, 301.0, 120.5, 0.0, 0.0, 1.0], expected [fx, skew"),
    ({f"{INFO}/K/4": -301}, f"{INFO}/K: found [300.0, "),
    ({f"{INFO}/K/1": 31.0}, f"{INFO}/K: found a skew of 31, expected 0.1 of fy"),
    ({f"{INFO}/K/8": 2}, f"{INFO}/K: found [300.0, "),
    ({f"{INFO}/K/2": NAN}, f"{INFO}/K/2: found nan, expected a finite number"),
    ({f"{INFO}/K": [1, 2, 3]}, f"{INFO}/K: found a list of 3, expected a list of 9 numbers"),
    ({f"{INFO}/D/1": INFINITY}, f"{INFO}/D/1: found inf, expected a finite number"),
    ({f"{INFO}/D/1": 1e300}, f"{INFO}/D/1: found 1e+300, expected a number from -1e+07 to 1e+07"),
    ({f"{INFO}/K/2": -1e300}, f"{INFO}/K: found [300.0, 0.0, -1e+300"),
    ({f"{INFO}/D": [0.1] * 8}, f"{INFO}/D: found a list of 8, expected 5 coefficients of plumb_bob"),
    ({f"{INFO}/height": 0}, f"{INFO}/height: found 0, expected a whole number from 1 to"),
    ({f"{INFO}/distortion_model": "fov"}, f"{INFO}/distortion_model: found 'fov', expected a known distortion"),
    (
        {f"{INFO}/distortion_model": ""},
        f"{INFO}/distortion_model: found '', expected a known distortion model: plumb_b",
    ),
    ({f"{INFO}/binning_x": 65}, f"{INFO}/binning_x: found 65, expected a whole number from 0 to 64"),
    ({f"{INFO}/roi": {"x_offset": 320, "width": 1}}, f"{INFO}/roi/x_offset: found 320, expected a whole number"),
    ({f"{INFO}/roi": {"width": 321}}, f"{INFO}/roi/width: found 321, expected a whole number from 1 to 320"),
    (
        {f"{FIRST}/data/cam/width": 640},
        f"{FIRST}/data/cam/width: found 640, expected 320 as in sensors/cam/camera_info",
    ),
    # sensors
    ({"sensors/cam": MISSING}, "sensors: missing sensor 'cam' of calibration_config/sensors"),
    (
        {f"{CONFIG}/sensors/lidar": MISSING, f"{CONFIG}/anchored_sensor": None},
        "sensors/lidar: sensor 'lidar' is missing in",
    ),
    (
        {"sensors/cam/modality": "radar"},
        "sensors/cam/modality: found 'radar', expected a known modality of sensor 'cam': rgb, lidar3d, lidar2d, depth",
    ),
    ({"sensors/lidar/modality": "lidar2d"}, "sensors/lidar/modality: found 'lidar2d', expected 'lidar3d' as in cali"),
    ({"sensors/lidar/modality": "sonar"}, "sensors/lidar/modality: found 'sonar', expected a known modality"),
    (
        {"sensors/cam/modality": "lidar3d"},
        "sensors/cam/modality: found 'lidar3d', expected 'rgb' as in calibration_config/",
    ),
    ({"sensors/cam/parent": "lidar_frame"}, "sensors/cam/parent: found 'lidar_frame', expected 'cam_optical' as in"),
    (
        {f"{CONFIG}/anchored_sensor": "radar"},
        f"{CONFIG}/anchored_sensor: found 'radar', expected a sensor (cam, lidar)",
    ),
    ({f"{CONFIG}/sensors": {}}, f"{CONFIG}/sensors: found an empty object, expected at least one sensor"),
    (
        {f"{CONFIG}/calibration_patterns": {}},
        f"{CONFIG}/calibration_patterns: found an empty object, expected at least",
    ),
    (
        {f"{FIRST}/labels/board/radar": {}},
        f"{FIRST}/labels/board/radar: no sensor 'radar' in the dataset (sensors: cam, l",
    ),
    ({f"{FIRST}/labels/wall": {}}, f"{FIRST}/labels/wall: no pattern 'wall' in the dataset (patterns: board)"),
    # numbers that are none
    ({f"{EDGE}/trans/0": NAN}, f"{EDGE}/trans/0: found nan, expected a finite number"),
    ({f"{EDGE}/trans/2": INFINITY}, f"{EDGE}/trans/2: found inf, expected a finite number"),
    ({f"{EDGE}/trans/2": HUGE}, f"{EDGE}/trans/2: found a huge integer, expected a finite number"),
    ({f"{EDGE}/quat/3": -INFINITY}, f"{EDGE}/quat/3: found -inf, expected a finite number"),
    ({f"{CAM}/idxs/0/x": NAN}, f"{CAM}/idxs/0/x: found nan, expected a finite number"),
    ({f"{CAM}/idxs/0/y": INFINITY}, f"{CAM}/idxs/0/y: found inf, expected a finite number"),
    ({f"{CAM}/idxs/0/id": NAN}, f"{CAM}/idxs/0/id: found nan, expected a finite number"),
    ({f"{LIDAR}/idxs/0": NAN}, f"{LIDAR}/idxs/0: found nan, expected a finite number"),
    # rotations
    ({f"{EDGE}/quat": [0, 0, 0, 0]}, f"{EDGE}/quat: found a quaternion of length 0, expected [x, y, z, w] of length 1"),
    ({f"{EDGE}/quat": [0, 0, 0, 1.0011]}, f"{EDGE}/quat: found a quaternion of length 1.0011, expected"),
    ({f"{EDGE}/quat": [0, 0, 1e200, 1e200]}, f"{EDGE}/quat: found a quaternion of length 1.41421e+200, expected"),
    # labels
    ({f"{CAM}/idxs/0/id": 6}, f"{CAM}/idxs/0/id: found 6, expected the id of a corner of pattern 'board', 0 to 5"),
    ({f"{CAM}/idxs/0/id": -1}, f"{CAM}/idxs/0/id: found -1, expected the id of a corner"),
    ({f"{CAM}/idxs/0/id": 1.5}, f"{CAM}/idxs/0/id: found 1.5, expected the id of a corner"),
    ({f"{CAM}/idxs/0/id": 1e300}, f"{CAM}/idxs/0/id: found 1e+300, expected the id of a corner"),
    ({f"{CAM}/idxs/3/id": 5}, f"{CAM}/idxs/3/id: found 5, expected every id once"),
    (
        {f"{SECOND}/labels/board/cam/idxs/2/id": 0},
        f"{SECOND}/labels/board/cam/idxs/2/id: found 0, expected every id once",
    ),
    (
        {"patterns": {"board": {"corners": [{"id": 0, "x": 1, "y": 1}]}}},
        f"{CAM}/idxs/0/id: found 5, expected the id of a",
    ),
    ({f"{LIDAR}/idxs/2": 9}, f"{LIDAR}/idxs/2: found 9, expected the index of one of the cloud's 9 points"),
    ({f"{LIDAR}/idxs/3": -1}, f"{LIDAR}/idxs/3: found -1, expected the index of a point of the cloud"),
    ({f"{LIDAR}/idxs/3": 2.5}, f"{LIDAR}/idxs/3: found 2.5, expected a whole number"),
    ({f"{LIDAR}/idxs/3": 2**50}, f"{LIDAR}/idxs/3: found {2**50}, expected the index of a point of the cloud"),
    ({f"{LIDAR}/idxs/3": 2**70}, f"{LIDAR}/idxs/3: found a huge integer, expected the index"),
    ({f"{LIDAR}/idxs_limit_points/1": 2}, f"{LIDAR}/idxs_limit_points/1: found 2, expected one of 'idxs'"),
    ({f"{LIDAR}/idxs_limit_points/1": 100}, f"{LIDAR}/idxs_limit_points/1: found 100, expected one of 'idxs'"),
    ({f"{LIDAR}/idxs_limit_points/1": -4}, f"{LIDAR}/idxs_limit_points/1: found -4, expected the index of a point"),
    (
        {f"{CAM}/idxs/4/x": 641},
        f"{CAM}/idxs/4: found a corner at (641, 80.25) px, expected one in the image of 320 x 240 px of sensor 'cam'",
    ),
    ({f"{CAM}/idxs/4/y": -1e308}, f"{CAM}/idxs/4: found a corner at (140.5, -1e+308) px, expected one in the image of"),
    (
        {f"{INFO}/width": 150, f"{FIRST}/data/cam/width": 150, f"{SECOND}/data/cam/width": 150},
        f"{CAM}/idxs/0: found a corner at (180.5, 120.25) px, one of 4 of 9 that sensor 'cam' has outside of its image",
    ),
    # collections
    ({"collections": {}}, "collections: found an empty object, expected at least one collection"),
    (
        {f"{CAM}/detected": False, f"{LIDAR}/detected": False, f"{SECOND}/labels": {}},
        "collections: none of the 2 collections",
    ),
    ({"collections/abc": {}}, "collections/abc: found the key 'abc', expected a number such as '000'"),
    ({"collections/-1": {}}, "collections/-1: found the key '-1', expected a number such as '000'"),
    ({"collections/²": {}}, "collections/²: found the key '²', expected a number such as '000'"),
    ({"collections/02": {}}, "collections/02: found number 2 twice, expected it once (other key: '002')"),
    ({f"{CONFIG}/sensors/{'x' * 300}": {}}, f"{CONFIG}/sensors: found a key of 300 characters ('xxxx"),
    # frames
    (
        {f"{CONFIG}/world_link": "map"},
        f"{CONFIG}/world_link: frame 'map' is not in the tree of the collections' transforms",
    ),
    ({f"{PATTERN}/parent_link": "hand"}, f"{PATTERN}/parent_link: frame 'hand' is not in the tree"),
    (
        {"sensors/cam/parent": "eye", f"{CONFIG}/sensors/cam/link": "eye"},
        "sensors/cam/parent: frame 'eye' is not in the tree of the collections' transforms (frames: world, mount, cam",
    ),
    (
        {"sensors/cam/calibration_parent": "hand", f"{CONFIG}/sensors/cam/parent_link": "hand"},
        "sensors/cam/calibration_parent: frame 'hand' is not in the tree",
    ),
    (
        {"sensors/cam/calibration_child": "hand", f"{CONFIG}/sensors/cam/child_link": "hand"},
        "sensors/cam/calibration_child: frame 'hand' is not in the tree",
    ),
    (
        {"sensors/cam/calibration_child": "lidar_base", f"{CONFIG}/sensors/cam/child_link": "lidar_base"},
        "sensors/cam/calibration_child: the transform to calibrate, 'mount-lidar_base', is not on the way from the",
    ),
    (
        {f"{CONFIG}/additional_tfs/mast/child_link": "cam_link"},
        f"{CONFIG}/additional_tfs/mast: 'world-cam_link' is none of the collections' transforms",
    ),
    ({f"{CONFIG}/additional_tfs/mast/child_link": MISSING}, f"{CONFIG}/additional_tfs/mast: missing key 'child_link'"),
    (
        {f"{EDGE}/parent": "world"},
        f"{EDGE}: found parent 'world' and child 'cam_link', expected those of the key",
    ),
    (
        {
            f"{SECOND}/transforms/lidar_base-lidar_frame": MISSING,
            f"{SECOND}/transforms/odd": documents.edge("lidar_base", "lidar_frame", [0, 0, 0])[
                "lidar_base-lidar_frame"
            ],
        },
        f"{SECOND}/transforms/odd: found parent 'lidar_base' and child 'lidar_frame', expected those of the key",
    ),
    (
        {f"{SECOND}/transforms/lidar_base-lidar_frame": MISSING},
        f"{SECOND}/transforms: missing key 'lidar_base-lidar_frame', which sensor 'lidar' needs",
    ),
    (
        {f"{SECOND}/transforms": documents.edge("world", "mount", [0, 0, 0])},
        f"{SECOND}/transforms: missing key 'mount-cam_link', which sensor 'cam' needs",
    ),
    (
        {f"{SECOND}/transforms/hand-cam_link": documents.edge("hand", "cam_link", [0, 0, 0])["hand-cam_link"]},
        f"{SECOND}/transforms/hand-cam_link: frame 'cam_link' has two parents, 'mount' and 'hand'",
    ),
    (
        {
            f"{SECOND}/transforms/cam_optical-world": documents.edge("cam_optical", "world", [0, 0, 0])[
                "cam_optical-world"
            ]
        },
        f"{SECOND}/transforms/cam_optical-world: frames form a loop: world -> mount -> cam_link -> cam_optical -> w",
    ),
    (
        {
            f"{FIRST}/transforms/table-cup": documents.edge("table", "cup", [0, 0, 0])["table-cup"],
            f"{PATTERN}/parent_link": "cup",
        },
        f"{PATTERN}/parent_link: frames 'world' and 'cup' are not connected",
    ),
    ({f"{PATTERN}/link": "cam_link"}, f"{PATTERN}/link: a pattern cannot be here: frame 'cam_link' has two parents"),
    ({f"{PATTERN}/link": "world"}, f"{PATTERN}/link: a pattern cannot be here: frames form a loop"),
]


@pytest.mark.parametrize(("changes", "message"), CASES, ids=[message for _, message in CASES])
def test_a_change_that_makes_it_wrong(tmp_path, changes, message):
    found = refused(documents.write(tmp_path, changed(documents.document(), changes)))
    assert message in found
    assert found.startswith(message.split(":")[0]) or "/" not in message.split(":")[0]


def test_the_number_1e999(tmp_path):
    path = documents.write(tmp_path, documents.document())
    path.write_text(path.read_text().replace("100.5", "1e999", 1))
    assert refused(path) == f"{SECOND}/labels/board/cam/idxs/0/x: found inf, expected a finite number"


@pytest.mark.parametrize("far", [1.1e4, 1e20, 3e38])
def test_a_labelled_point_that_no_sensor_can_see(tmp_path, far):
    path = documents.write(tmp_path, documents.document())
    cloud = documents.CLOUD.copy()
    cloud[4, 1] = -far
    write_points(tmp_path / "lidar_000.pcd", cloud)
    expected = f"found point 4 of sensor 'lidar' {far:g} m away, expected 10000 m at most"
    assert refused(path) == f"{LIDAR}/idxs/2: {expected}"


def test_a_distant_point_without_a_label_is_accepted(tmp_path):
    path = documents.write(tmp_path, documents.document())
    cloud = documents.CLOUD.copy()
    cloud[0] = 1e20  # the labels are 1, 3, 4 and 7
    write_points(tmp_path / "lidar_000.pcd", cloud)
    read_dataset(path)


@pytest.mark.filterwarnings("error")
def test_a_signalling_nan_is_refused_without_a_warning(tmp_path):
    path = documents.write(tmp_path, documents.document())
    file = tmp_path / "lidar_000.pcd"
    data = bytearray(file.read_bytes())
    start = len(data) - 12 * len(documents.CLOUD)
    data[start + 48 : start + 52] = bytes.fromhex("0100a07f")
    file.write_bytes(data)
    assert refused(path).startswith(f"{LIDAR}/idxs/2: point 4 of the cloud is not finite")


def test_intrinsics_are_those_of_the_part_of_the_sensor_that_is_read(tmp_path):
    """REP 104: the offset first, then the binning; the corners lie within 160 x 120 pixels."""
    whole = documents.document()["sensors"]["cam"]["camera_info"]
    fx, _, cx, _, fy, cy, *_ = whole["K"]
    change = {
        f"{INFO}/K/1": 3.0,
        f"{INFO}/width": 1280,
        f"{INFO}/height": 960,
        f"{INFO}/roi": {"x_offset": 100, "y_offset": 40, "width": 640, "height": 480},
        f"{INFO}/binning_x": 2,
        f"{INFO}/binning_y": 2,
    }
    camera = read_dataset(documents.write(tmp_path, changed(documents.document(), change))).sensors["cam"].camera
    assert (camera.width, camera.height) == (320, 240)
    assert (camera.fx, camera.fy, camera.skew) == (fx / 2, fy / 2, 1.5)
    assert (camera.cx, camera.cy) == ((cx - 100) / 2, (cy - 40) / 2)


def test_a_region_of_the_whole_image_is_none(tmp_path):
    region = {"x_offset": 0, "y_offset": 0, "width": 320, "height": 240, "do_rectify": False}
    read_dataset(
        documents.write(tmp_path, changed(documents.document(), {f"{INFO}/roi": region, f"{INFO}/binning_x": 1}))
    )


@pytest.mark.parametrize("place", range(6))
def test_the_transform_that_breaks_the_tree_is_found_at_any_position(tmp_path, place):
    content = documents.document()
    transforms = list(content["collections"]["000"]["transforms"].items())
    transforms[place:place] = documents.edge("hand", "mount", [0, 0, 0]).items()
    content["collections"]["000"]["transforms"] = dict(transforms)
    at = "hand-mount" if place else "world-mount"
    found = refused(documents.write(tmp_path, content))
    assert found.startswith(f"{FIRST}/transforms/{at}: frame 'mount' has two parents")


def test_two_patterns_in_one_place(tmp_path):
    content = documents.document()
    patterns = content[CONFIG]["calibration_patterns"]
    patterns["other"] = patterns["board"]
    message = refused(documents.write(tmp_path, content))
    assert (
        message
        == f"{CONFIG}/calibration_patterns/other/link: found 'board_link', expected a frame that no other pattern has"
    )


def test_version_2_has_one_pattern(tmp_path):
    content = documents.version_2()
    pattern = content[CONFIG].pop("calibration_pattern")
    content[CONFIG]["calibration_patterns"] = {"a": pattern, "b": {**pattern, "link": "b_link"}}
    assert "expected one pattern in a dataset of version 2.0" in refused(documents.write(tmp_path, content))


def test_version_2_names_its_only_pattern_by_its_key(tmp_path):
    content = changed(documents.version_2(), {f"{CONFIG}/calibration_pattern/size": -1})
    found = refused(documents.write(tmp_path, content))
    assert found == f"{CONFIG}/calibration_pattern/size: found -1, expected a number from 1e-06 to 1000"


def test_collections_without_common_transforms_do_not_fill_the_memory(tmp_path):
    content = documents.document()
    first = content["collections"]["000"]
    for i in range(3, 1500):
        odd = documents.edge("mount", f"frame_{i}", [0, 0, 0])
        content["collections"][f"{i:03d}"] = {"transforms": first["transforms"] | odd, "labels": {}}
    found = refused(documents.write(tmp_path, content))
    assert found.startswith("collections/000: the 1499 collections have 1502 different transforms")


# The file itself.


def test_no_such_file(tmp_path):
    assert refused(tmp_path / "missing") == "a dataset was expected, but it cannot be read: No such file or directory"
    with pytest.raises(InputError, match=r"dataset\.json: .* cannot be read: No such file"):
        read_dataset(tmp_path)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "\ud800"])
def test_a_name_that_no_file_can_have(tmp_path, name):
    with pytest.raises(InputError, match="cannot be read") as caught:
        read_dataset(tmp_path / name)
    assert str(caught.value).isprintable()


def test_something_else_than_a_file(tmp_path):
    os.mkfifo(tmp_path / "dataset.json")  # reading it would wait for ever
    with pytest.raises(InputError, match="no regular file"):
        read_dataset(tmp_path)
    assert "no regular file" in refused("/dev/zero")


def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    path = documents.write(tmp_path, documents.document())

    def denied(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    assert refused(path) == "a dataset was expected, but it cannot be read: Permission denied"


def test_a_file_of_more_than_a_gibibyte(tmp_path):
    path = tmp_path / "dataset.json"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    assert refused(path) == "found 1073741825 bytes, a dataset of at most 1073741824 was expected"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "found an empty file, expected JSON"),
        (b" \n", "found an empty file, expected JSON"),
        (b'{"a": 1,\n  "b" 2}', "line 2, column 7: not JSON: Expecting ':' delimiter"),
        (b"not json", "line 1, column 1: not JSON: Expecting value"),
        (b'{"a": [1, 2', "line 1, column 12: the file ends in the middle of its JSON; is it truncated?"),
        (b'{"a": "text', "line 1, column 7: the file ends in the middle of its JSON; is it truncated?"),
        (b'{"a": 1} x', "line 1, column 10: not JSON: Extra data"),
        (b"[1, 2]", "found a list of 2, expected an object"),
        (b"null", "found null, expected an object"),
        (b'{"a": "\xff"}', "byte 7: found no UTF-8 text, expected JSON"),
        (b"\x80\x02", "byte 0: found no UTF-8 text, expected JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (b'{"a": ' + b"1" * 5000 + b"}", "cannot be read as JSON: Exceeds the limit"),
    ],
)
def test_a_file_that_is_no_json_object(tmp_path, content, message):
    path = tmp_path / "dataset.json"
    path.write_bytes(content)
    assert refused(path).startswith(message)


def test_every_truncation_is_refused(tmp_path):
    path = documents.write(tmp_path, documents.document())
    content = path.read_bytes()
    for length in range(0, len(content) - 1, 31):
        path.write_bytes(content[:length])
        assert "the file ends in the middle" in refused(path) or length < 2


def test_a_message_is_short_and_one_line_whatever_the_names(tmp_path):
    name = "a\nb\r\x1b[31m\u2028" + "x" * 10_000 + "\ud800"
    content = documents.document()
    content["collections"]["000"]["labels"][name] = {}
    found = refused(documents.write(tmp_path, content))
    assert "\\n" in found
    assert "\\x1b" in found
    found.encode()
    content = changed(documents.document(), {"_metadata/version": name})
    assert len(refused(documents.write(tmp_path, content))) < 300


# Point clouds.


def cloud_refused(tmp_path, message, labels=None, **changes):
    """The message must be about the file of collection 000's LiDAR."""
    content = changed(documents.document(), {f"{FIRST}/data/lidar/{key}": value for key, value in changes.items()})
    path = documents.write(tmp_path, content) if labels is None else labels
    found = refused(path)
    assert found.startswith(f"{FIRST}/data/lidar/"), found
    assert message in found


@pytest.mark.parametrize(
    "name",
    [
        "../lidar_000.pcd",
        "/etc/passwd",
        "a/../../x.pcd",
        "a/../b.pcd",
        "..",
        "",
        "out/x.pcd",
        "link.pcd",
    ],
)
def test_a_file_outside_the_datasets_folder(tmp_path, name):
    inside = tmp_path / "inside"
    documents.write(tmp_path, documents.document())
    inside.mkdir()
    (inside / "a").mkdir()
    documents.write_points(inside / "b.pcd", CLOUD)
    (inside / "out").symlink_to(tmp_path)
    (inside / "link.pcd").symlink_to(tmp_path / "lidar_000.pcd")
    expected = "expected a name" if not name else "expected a file in the dataset's folder"
    cloud_refused(inside, expected, data_file=name)


def test_a_loop_of_links(tmp_path):
    documents.write(tmp_path, documents.document())
    (tmp_path / "loop").symlink_to("loop")
    cloud_refused(tmp_path, "loop/a", data_file="loop/a")  # Python 3.13 finds the loop only when it opens the file


@pytest.mark.parametrize("name", ["folder", ".", "a\0b", "x" * 5000])
def test_a_cloud_that_is_no_file(tmp_path, name):
    (tmp_path / "folder").mkdir()
    cloud_refused(tmp_path, "no regular file" if name in ("folder", ".") else "cannot be read", data_file=name)


def test_a_name_that_is_no_text(tmp_path):
    cloud_refused(tmp_path, "data_file: found 5, expected text", data_file=5)


HEADER = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 9\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
    "POINTS 9\nDATA binary\n"
)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("", "found no line 'DATA ...', expected the header of a PCD file"),
        (HEADER.replace("DATA", "DATE"), "found no line 'DATA ...'"),
        (HEADER.replace("binary", "binary_lzf"), "found DATA 'binary_lzf', expected "),
        (HEADER.replace("binary", "ascii"), "is it truncated?"),
        (HEADER.replace("9", "10"), "found 108 bytes of points, expected 120 for 10 points; is it truncated?"),
        (HEADER.replace("9", "99999999999"), "found 108 bytes of points, expected 1199999999988 for 99999999999"),
        (HEADER.replace("9", "9" * 5000), "expected a number"),
        (HEADER.replace("WIDTH 9", "WIDTH 8"), "found POINTS 9, expected WIDTH times HEIGHT, 8"),
        (HEADER.replace("POINTS 9\n", "").replace("WIDTH 9\n", ""), "found neither POINTS nor WIDTH"),
        (HEADER.replace("POINTS 9", "POINTS nine"), "found POINTS 'nine', expected a number"),
        (HEADER.replace("POINTS 9", "POINTS -9"), "found POINTS '-9', expected a number"),
        (HEADER.replace("POINTS 9", "POINTS"), "found POINTS '', expected a number"),
        (HEADER.replace("FIELDS x y z", "FIELDS x y"), "found 3 values of SIZE for 2 FIELDS"),
        (HEADER.replace("FIELDS x y z", "FIELDS x y w"), "found FIELDS 'x y w', expected one each of x, y and z"),
        (HEADER.replace("FIELDS x y z\n", ""), "found 3 values of SIZE for 0 FIELDS"),
        (HEADER.replace("TYPE F F F", "TYPE F I F"), "found 'y' as 1 'I' of 4 bytes, expected one 'F' of 4 or 8"),
        (HEADER.replace("SIZE 4 4 4", "SIZE 4 4 2"), "found 'z' as 1 'F' of 2 bytes, expected one 'F' of 4 or 8"),
        (HEADER.replace("COUNT 1 1 1", "COUNT 1 1 3"), "found 'z' as 3 'F' of 4 bytes, expected one 'F' of 4 or 8"),
        (HEADER.replace("COUNT 1 1 1", "COUNT 1 1 x"), "found COUNT 'x', expected a number"),
    ],
)
def test_a_broken_cloud(tmp_path, header, message):
    path = documents.write(tmp_path, documents.document())
    (tmp_path / "lidar_000.pcd").write_bytes(header.encode() + CLOUD.tobytes())
    cloud_refused(tmp_path, message, labels=path)


def test_a_truncated_cloud(tmp_path):
    path = documents.write(tmp_path, documents.document())
    content = (tmp_path / "lidar_000.pcd").read_bytes()
    for length in range(len(content)):
        (tmp_path / "lidar_000.pcd").write_bytes(content[:length])
        refused(path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_labelled_point_that_is_not_finite(tmp_path, value):
    path = documents.write(tmp_path, documents.document())
    cloud = CLOUD.copy()
    cloud[4, 1] = value
    documents.write_points(tmp_path / "lidar_000.pcd", cloud)
    assert refused(path) == f"{LIDAR}/idxs/2: point 4 of the cloud is not finite; a labelled point must be"


MESSAGE = {
    "height": 1,
    "width": 9,
    "point_step": 12,
    "row_step": 108,
    "is_bigendian": False,
    "fields": [{"name": axis, "offset": 4 * i, "datatype": 7, "count": 1} for i, axis in enumerate("xyz")],
    "data": list(CLOUD.tobytes()),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data": [1, 2, 300]}, "data: found no bytes, expected base64 text or a list of numbers from 0 to 255"),
        ({"data": ["a"]}, "data: found no bytes"),
        ({"data": "not base64!"}, "data: found no bytes"),
        ({"data": base64.b64encode(CLOUD.tobytes()).decode() + "!!!!"}, "data: found no bytes"),
        ({"data": {"a": 1}}, "data: found an object of 1 keys, expected a list"),
        ({"data": [0] * 107}, "data: found 107 bytes, expected 1 x 9 points of 12 bytes"),
        ({"width": 10**9}, "data: found 108 bytes, expected 1 x 1000000000 points of 12 bytes"),
        ({"width": "9"}, "width: found '9', expected a finite number"),
        ({"point_step": 0}, "point_step: found 0, expected a whole number from 1"),
        ({"height": 2, "row_step": 10}, "row_step: found 10, expected a whole number from 108"),
        ({"fields": MISSING}, "missing key 'fields'"),
        ({"fields/1/name": "x"}, "fields: missing field 'y'"),
        ({"fields/1/datatype": 4}, "fields/1/datatype: found 4, expected a whole number from 7 to 8"),
        ({"fields/1/datatype": [7]}, "fields/1/datatype: found a list of 1, expected a finite number"),
        ({"fields/1/offset": 9}, "fields/1/offset: found 9, expected a whole number from 0 to 8"),
        ({"is_bigendian": "yes"}, "is_bigendian: found 'yes', expected true or false"),
    ],
)
def test_a_broken_message(tmp_path, changes, message):
    content = changed(documents.document(), {f"{FIRST}/data/lidar": changed(MESSAGE, changes)})
    found = refused(documents.write(tmp_path, content))
    assert found.startswith(f"{FIRST}/data/lidar")
    assert message in found


def test_the_message_as_it_is_can_be_read(tmp_path):
    path = documents.write(tmp_path, changed(documents.document(), {f"{FIRST}/data/lidar": MESSAGE}))
    json.loads(path.read_text())
    assert ("board", "lidar") in read_dataset(path).collections[0].labels
