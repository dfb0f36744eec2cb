"""Chains of frames against the true ones, in ATOM's form."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.truth import Truth, find_truth, ground_truth_frame, ground_truth_transform, truth_of
from calibration.engine.geometry.transforms import from_xyz_rpy
from tests.engine.evaluation.scene import two_cameras

COLUMNS = ("Trans (m)", "Rot (rad)", "X (m)", "Y (m)", "Z (m)", "Roll (rad)", "Pitch (rad)", "Yaw (rad)")
LEFT, RIGHT, BOARD = ("left_mount", "left_link"), ("right_mount", "right_link"), ("world", "board_link")
ERROR = from_xyz_rpy([0.01, -0.01, 0.02], [0.1, -0.2, 0.3])


def with_truth(n=3):
    dataset, T_world_pattern = two_cameras(n=n)
    dataset = dataset.with_transforms({BOARD: T_world_pattern})
    return dataset, truth_of(dataset)


def wrong(dataset, edge, error=ERROR):
    return dataset.with_transforms({edge: dataset.transforms[edge] @ error})


def test_the_error_is_seen_from_the_true_child():
    dataset, truth = with_truth()
    table = ground_truth_transform(wrong(dataset, LEFT), truth, "world", "left_link")
    assert (table.key, table.columns, table.labels) == ("Collection #", COLUMNS, dataset.keys)
    angle = np.arccos((np.trace(ERROR[:3, :3]) - 1) / 2)
    expected = [np.sqrt(6e-4), angle, 0.01, -0.01, 0.02, 0.1, -0.2, 0.3]
    np.testing.assert_allclose(table.values, np.tile(expected, (3, 1)), atol=1e-12)
    np.testing.assert_allclose(ground_truth_transform(dataset, truth, "world", "left_link").values, 0, atol=1e-12)


def test_every_calibrated_transform_has_a_row():
    dataset, truth = with_truth()
    table = ground_truth_frame(wrong(dataset, LEFT), truth, "world")
    assert (table.key, table.columns, table.labels) == ("Transformation #", COLUMNS, ("left", "right"))
    np.testing.assert_allclose(table.values[0, 2:], [0.01, 0.01, 0.02, 0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(table.values[1], 0, atol=1e-12)
    assert ground_truth_frame(replace(dataset, anchored="left"), truth, "world").labels == ("right",)
    more = replace(dataset, additional_transforms=(BOARD,))
    assert ground_truth_frame(more, truth, "world").labels == ("left", "right", "world-board_link")


def test_one_sensor_has_a_row_for_every_collection():
    dataset, truth = with_truth()
    of_left = ground_truth_frame(wrong(dataset, LEFT), truth, "world", "left")
    assert of_left.to_csv() == ground_truth_transform(wrong(dataset, LEFT), truth, "world", "left_link").to_csv()
    with pytest.raises(InputError, match="no sensor 'up'"):
        ground_truth_frame(dataset, truth, "world", "up")


def test_a_pattern_has_a_true_pose_in_each_collection():
    dataset, truth = with_truth()
    poses = dataset.transforms[BOARD].copy()
    poses[1] = poses[1] @ ERROR
    table = ground_truth_transform(dataset.with_transforms({BOARD: poses}), truth, "world", "board_link")
    np.testing.assert_allclose(table.values[:, 4], [0, 0.02, 0], atol=1e-12)
    partly = Truth(truth.path, truth.sensors, truth.transforms, {"000": truth.patterns["000"]})
    with pytest.raises(InputError, match="001/transforms: no 'world-board_link'"):
        ground_truth_transform(dataset, partly, "world", "board_link")


def test_without_a_truth_on_the_way_nothing_is_tested():
    dataset, truth = with_truth()
    with pytest.raises(InputError, match="no true transform on the way from 'world' to 'left_mount'"):
        ground_truth_transform(dataset, truth, "world", "left_mount")
    with pytest.raises(InputError, match=r"there is no truth to compare with \(ground_truth.json beside it"):
        ground_truth_transform(dataset, None, "world", "left_link")
    with pytest.raises(InputError, match="'sky'"):
        ground_truth_transform(dataset, truth, "sky", "left_link")
    alone = replace(dataset, sensors={"left": dataset.sensors["left"]}, anchored="left")
    with pytest.raises(InputError, match="nothing is calibrated"):
        ground_truth_frame(alone, truth, "world")


def test_a_synthetic_dataset_holds_its_own_truth(shared_data):
    dataset = read_dataset(shared_data / "synthetic" / "t2rgb")
    table = ground_truth_frame(dataset, find_truth(dataset), dataset.world)
    assert table.labels == tuple(dataset.sensors)
    assert set(table.to_csv().splitlines()[-1].split(",")[1:]) == {"0.0000"}
