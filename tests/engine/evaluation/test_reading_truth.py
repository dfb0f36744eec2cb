import json

import numpy as np
import pytest

from calibration.base import ExitCode, InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.truth import Truth, find_truth, read_truth, truth_of
from calibration.engine.geometry.transforms import from_quaternion
from tests.engine.dataset import documents
from tests.engine.dataset.documents import MISSING, changed, edge
from tests.engine.dataset.test_joints import document as jointed

CAM, LIDAR, BOARD = ("mount", "cam_link"), ("mount", "lidar_base"), ("world", "board_link")


def pose(parent, child, x=0.0):
    return edge(parent, child, [x, 0.0, 1.0])[f"{parent}-{child}"]


DOCUMENT = {
    "sensors": {"cam": pose(*CAM, 1.0), "lidar": pose(*LIDAR, 2.0)},
    "patterns": {"000": pose(*BOARD, 3.0), "002": [pose(*BOARD, 4.0), pose("hand", "cube", 5.0)]},
    "pattern": pose("flange", "card", 6.0),
    "transforms": [pose("world", "mount", 7.0)],
    "seed": 100,
    "px_sigma": 0.3,
}


@pytest.fixture
def dataset(tmp_path):
    return read_dataset(documents.write(tmp_path, documents.document()))


def read(folder, document):
    path = folder / "ground_truth.json"
    path.write_text(json.dumps(document))
    return read_truth(path)


def test_a_truth(tmp_path):
    truth = read(tmp_path, DOCUMENT)
    assert truth.path == tmp_path / "ground_truth.json"
    assert truth.sensors == {"cam": CAM, "lidar": LIDAR}
    assert set(truth.transforms) == {CAM, LIDAR, ("flange", "card"), ("world", "mount")}
    np.testing.assert_array_equal(truth.transforms[LIDAR], from_quaternion([2, 0, 1], [0, 0, 0, 1]))
    assert truth.patterns["000"][BOARD][0, 3] == 3
    assert truth.patterns["002"][BOARD][0, 3] == 4
    assert truth.patterns["002"]["hand", "cube"][0, 3] == 5


def test_a_truth_beside_the_dataset_is_found(dataset, tmp_path):
    assert find_truth(dataset) is None
    read(tmp_path, DOCUMENT)
    assert find_truth(dataset).sensors["cam"] == CAM


def test_a_truth_about_something_else_is_an_error(dataset, tmp_path):
    read(tmp_path, changed(DOCUMENT, {"sensors/cam": pose("arm", "cam_link")}))
    with pytest.raises(InputError) as caught:
        find_truth(dataset)
    expected = "sensors: missing transform, expected that of 'mount-cam_link', which sensor 'cam' calibrates"
    assert str(caught.value) == f"{tmp_path / 'ground_truth.json'}: {expected}"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensors": MISSING}, "missing key 'sensors'"),
        ({"sensors": []}, "sensors: found an empty list, expected an object"),
        ({"sensors/cam/quat": [0, 0, 0, 2]}, "sensors/cam/quat: found a quaternion of length 2, expected"),
        ({"sensors/cam/quat": [0, 0, 0, 0]}, "sensors/cam/quat: found a quaternion of length 0, expected"),
        ({"sensors/cam/trans/1": float("nan")}, "sensors/cam/trans/1: found nan, expected a finite number"),
        ({"sensors/cam/parent": MISSING}, "sensors/cam: missing key 'parent'"),
        ({"pattern/child": 5}, "pattern/child: found 5, expected text"),
        ({"patterns/002/1/trans": [1]}, "patterns/002/1/trans: found a list of 1, expected a list of 3 numbers"),
        ({"patterns": [1]}, "patterns: found a list of 1, expected an object"),
        ({"transforms": {"a": 1}}, "transforms: found an object of 1 keys, expected a list"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, changes, message):
    with pytest.raises(InputError) as caught:
        read(tmp_path, changed(DOCUMENT, changes))
    assert str(caught.value).startswith(f"{tmp_path / 'ground_truth.json'}: {message}")
    assert caught.value.exit_code == ExitCode.BAD_INPUT


def test_the_transforms_of_a_dataset_as_the_truth(dataset):
    truth = truth_of(dataset)
    assert truth.sensors == {"cam": CAM, "lidar": LIDAR}
    assert set(truth.transforms) == {CAM, LIDAR, ("world", "mount")}
    np.testing.assert_array_equal(truth.transforms[CAM], dataset.transforms[CAM][0])
    assert truth.patterns == {"000": {}, "002": {}}


@pytest.mark.parametrize("fixed", [True, False])
def test_patterns_in_a_dataset_are_part_of_its_truth(tmp_path, fixed):
    changes = {
        "calibration_config/calibration_patterns/board/fixed": fixed,
        "collections/002/transforms/world-board_link": pose(*BOARD, 3.0),
    }
    truth = truth_of(read_dataset(documents.write(tmp_path, changed(documents.document(), changes))))
    assert truth.patterns["000"] == {}
    assert truth.patterns["002"][BOARD][0, 3] == 3
    assert (BOARD in truth.transforms) == fixed


def test_a_transform_that_differs_is_no_truth(dataset):
    T = dataset.transforms[CAM].copy()
    T[1, 0, 3] += 1e-6
    with pytest.raises(InputError, match="collections/002/transforms/mount-cam_link: differs from collection 000"):
        truth_of(dataset.with_transforms({CAM: T}))


@pytest.mark.parametrize("name", ["t2rgb", "riwbot", "rlbot"])
def test_the_synthetic_datasets_hold_their_truth(shared_data, name):
    dataset = read_dataset(shared_data / "synthetic" / name)
    beside, inside = find_truth(dataset), truth_of(dataset)
    assert isinstance(beside, Truth)
    assert set(beside.transforms) == set(inside.transforms)
    for key, T in beside.transforms.items():
        np.testing.assert_allclose(inside.transforms[key], T, atol=1e-12)
    assert set(beside.patterns) == set(dataset.keys)


JOINTS = {"elbow": {"origin_z": 0.105, "position_bias": -0.02}, "wrist": {"origin_yaw": 0.01}}


def test_joints_of_a_truth(tmp_path):
    truth = read(tmp_path, {**DOCUMENT, "joints": JOINTS})
    assert truth.joints == JOINTS
    assert read(tmp_path, DOCUMENT).joints == {}


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ({"elbow": {"yaw": 0.1}}, "joints/elbow/yaw: there is no parameter 'yaw', expected one of origin_x, "),
        ({"elbow": {"origin_x": "far"}}, "joints/elbow/origin_x: found 'far'"),
        ({"elbow": {"origin_x": True}}, "joints/elbow/origin_x: found "),
        ({"elbow": 0.1}, "joints/elbow: "),
        ([1], "joints: "),
    ],
)
def test_wrong_joints(tmp_path, joints, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, {**DOCUMENT, "joints": joints})


def test_the_truth_beside_a_dataset_has_its_joints(tmp_path):
    dataset = read_dataset(documents.write(tmp_path, jointed()))
    beside = {**DOCUMENT, "joints": {"elbow": {"origin_x": 0.11}}}
    (dataset.path.parent / "ground_truth.json").write_text(json.dumps(beside))
    with pytest.raises(InputError, match=r"ground_truth\.json: joints/elbow: missing 'position_bias'"):
        find_truth(dataset)
    beside["joints"]["elbow"]["position_bias"] = 0.0
    (dataset.path.parent / "ground_truth.json").write_text(json.dumps(beside))
    assert find_truth(dataset).joints["elbow"] == {"origin_x": 0.11, "position_bias": 0.0}
    assert truth_of(dataset).joints == {"elbow": {"origin_x": 0.1, "position_bias": 0.0}}
