"""Residuals label by label: those that the calibration has made small."""

from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.evaluation.residuals import residuals
from calibration.engine.geometry.transforms import retract

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
