"""Errors of labels against the patterns' poses of a dataset, as a table and one by one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.evaluation.label_errors import residuals, single_rgb
from calibration.engine.geometry.transforms import from_xyz_rpy, retract
from tests.engine.evaluation.scene import arm, pattern, two_cameras, with_labels

BOARD = ("world", "board_link")


def placed(seed=0, n=4, noise=0.0):
    dataset, T_world_pattern = two_cameras(seed, n, noise)
    return dataset.with_transforms({BOARD: T_world_pattern})


def test_exact_poses_leave_nothing():
    table = single_rgb(placed())
    assert table.key == "Collection"
    assert table.columns == ("left-board [px]", "right-board [px]", "all [px]")
    assert table.labels == ("000", "001", "002", "003")
    np.testing.assert_allclose(table.values, 0, atol=1e-9)


def test_a_known_shift_is_its_distance_in_pixels():
    dataset = placed(1, n=1)
    labels = dataset.collections[0].labels["board", "left"]
    shifted = with_labels(dataset, "left", [replace(labels, pixels=labels.pixels + np.array([3.0, -4.0]))])
    np.testing.assert_allclose(single_rgb(shifted).values, [[5, 0, 2.5]], atol=1e-9)


def test_noise_shows_its_mean_distance():
    table = single_rgb(placed(2, n=40, noise=0.5))
    assert table.average("all [px]") == pytest.approx(0.5 * np.sqrt(np.pi / 2), rel=0.05)  # Rayleigh's mean


def test_what_a_camera_does_not_see_is_missing():
    dataset = placed(3)
    labels = [c.labels["board", "left"] for c in dataset.collections]
    none = with_labels(with_labels(dataset, "left", [None, *labels[1:3], None]), "right", [*labels[:3], None])
    table = single_rgb(none)
    lines = table.to_csv().splitlines()
    assert lines[1].startswith("000,---,")
    assert table.labels == ("000", "001", "002")
    assert table.left_out == ("003: no camera sees a pattern",)
    np.testing.assert_allclose(table.values[0, 1], table.values[0, 2])
    assert table.average("left-board [px]") < 1e-9  # the missing one has no part in it


def test_a_collection_without_a_pose_of_the_pattern_has_no_value():
    dataset = placed(4)
    poses = dataset.transforms[BOARD].copy()
    poses[2] = np.nan
    assert single_rgb(dataset.with_transforms({BOARD: poses})).labels == ("000", "001", "003")
    with pytest.raises(InputError, match="no camera sees a pattern whose pose the dataset has"):
        single_rgb(two_cameras()[0])


def test_a_pattern_behind_the_camera_is_infinitely_wrong():
    dataset = placed(5)
    behind = retract(dataset.transforms[BOARD], np.broadcast_to([0.0, 0, -5, 0, 0, 0], (4, 6)))
    assert np.isinf(single_rgb(dataset.with_transforms({BOARD: behind})).values).all()


def test_one_camera_and_one_pattern_are_chosen():
    dataset = placed(6)
    other = replace(pattern(name="card"), corners=pattern().corners * 2)
    several = replace(dataset, patterns={**dataset.patterns, "card": other}).with_transforms(
        {("world", "card_link"): from_xyz_rpy([1, 0, 0], [0, 0, 0])}
    )
    assert single_rgb(several).columns == (
        "left-board [px]",
        "right-board [px]",
        "left-card [px]",
        "right-card [px]",
        "all [px]",
    )
    assert single_rgb(several, "right", "board").columns == ("right-board [px]", "all [px]")
    with pytest.raises(InputError, match="no sensor 'up'"):
        single_rgb(dataset, "up")
    with pytest.raises(InputError, match="no pattern 'card'"):
        single_rgb(dataset, None, "card")


def test_a_fixed_pattern_on_an_arm():
    np.testing.assert_allclose(single_rgb(arm(n=3)).values, 0, atol=1e-9)


def test_the_synthetic_arm_shows_the_noise_of_its_labels(shared_data):
    table = single_rgb(read_dataset(shared_data / "synthetic" / "riwbot"))
    assert table.average("all [px]") == pytest.approx(0.3 * np.sqrt(np.pi / 2), rel=0.03)


DATASETS = Path(__file__).parents[3] / "datasets"


@pytest.mark.parametrize("name", ["t2rgb", "rlbot"])
def test_their_rms_is_the_noise_that_the_calibration_states(name: str) -> None:
    calibration = calibrate(read_dataset(DATASETS / name))
    dataset, levels = calibration.dataset, calibration.noise_levels
    for sensor in dataset.sensors.values():
        found = residuals(dataset, sensor)
        assert len(found.collections) == len(found.where) == len(found.values) > 500
        stated = levels.pixel if sensor.camera is not None else levels.range
        assert stated is not None
        spread = 1.4826 * float(np.median(np.abs(found.values)))  # of a normal distribution; outliers have no part
        assert spread == pytest.approx(stated, rel=0.35)


def test_a_sensor_that_is_moved_shows_it() -> None:
    dataset = calibrate(read_dataset(DATASETS / "t2rgb")).dataset
    sensor = dataset.sensors["right_camera"]
    moved = retract(dataset.transforms[sensor.edge], np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]))
    before, after = (
        residuals(each, sensor).sizes.mean() for each in (dataset, dataset.with_transforms({sensor.edge: moved}))
    )
    assert after > 10 * before


def test_views_without_a_pose_are_left_out() -> None:
    dataset = calibrate(read_dataset(DATASETS / "t2rgb")).dataset
    [pattern] = dataset.patterns.values()
    poses = dataset.transforms[pattern.parent_link, pattern.link].copy()
    poses[3] = np.nan
    found = residuals(
        dataset.with_transforms({(pattern.parent_link, pattern.link): poses}), dataset.sensors["left_camera"]
    )
    whole = residuals(dataset, dataset.sensors["left_camera"])
    assert set(whole.collections) - set(found.collections) == {3}
