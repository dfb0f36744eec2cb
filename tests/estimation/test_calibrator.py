"""Calibrations of a dataset from many initial guesses: the same results, to the last bit, as one by one."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.dataset.model import Dataset
from calibration.dataset.reading import read_dataset
from calibration.errors import UndeterminedError
from calibration.estimation.calibrate import Calibrator, Options, calibrate
from calibration.estimation.result import Calibration
from calibration.estimation.starting_noise import StartingNoise
from tests.estimation.systems import camera_and_lidar, stereo
from tests.estimation.test_wrong_views import exchanged
from tests.pipeline.conftest import DATASETS

NOISES = [StartingNoise(0.02, 0.02, seed) for seed in (1, 2, 3)]
ANYWHERE = StartingNoise(0.5, 0.5, 7)


def scene(name: str) -> Dataset:
    if name == "LiDAR":
        return camera_and_lidar(8, pixel_noise=0.3, range_noise=0.005).dataset()
    if name == "exchanged views":
        return exchanged(read_dataset(DATASETS / "riwbot"), "rgb_world", (3, 8, 11))
    return stereo(8, pixel_noise=0.3).dataset()


def assert_equal(one: Calibration, other: Calibration) -> None:
    for name in ("converged", "reason", "cost", "iterations", "noise_levels", "rejected", "notes", "dropped_views"):
        assert getattr(one, name) == getattr(other, name)
    for edge, T in other.transforms.items():
        np.testing.assert_array_equal(one.transforms[edge], T)
    for edge, covariance in other.covariances.items():
        np.testing.assert_array_equal(one.covariances[edge], covariance)


@pytest.mark.parametrize("name", ["cameras", "LiDAR", "exchanged views"])
@pytest.mark.parametrize("start", ["linear", "given"])
def test_calibrations_of_one_calibrator_are_those_of_calibrate(name: str, start: str) -> None:
    dataset, options = scene(name), Options(start=start)  # type: ignore[arg-type]
    calibrator = Calibrator(dataset, options)
    for noise in (*NOISES, ANYWHERE):
        assert_equal(calibrator.calibrate(noise), calibrate(dataset, options, noise))


@pytest.mark.parametrize("system", ["t2rgb", "rlbot", "softbot", "riwbot", "spjbot"])
def test_a_guess_ends_at_the_calibration_of_the_linear_start_to_the_last_bit(system: str) -> None:
    dataset = read_dataset(DATASETS / system)
    linear = Calibrator(dataset, Options())
    given = Calibrator(dataset, Options(start="given"))
    calibrations = [linear.calibrate(ANYWHERE), linear.calibrate(NOISES[0])]
    assert calibrations[0] is calibrations[1]
    for noise in NOISES:
        found = given.calibrate(noise)
        assert found.converged
        assert_equal(replace(found, iterations=calibrations[0].iterations), calibrations[0])


def test_a_guess_that_ends_elsewhere_has_the_calibration_there() -> None:
    dataset = scene("cameras")
    given, linear = Calibrator(dataset, Options(start="given")), calibrate(dataset)
    found = [given.calibrate(StartingNoise(3.0, 2.5, seed)) for seed in range(1, 6)]
    elsewhere = [each for each in found if not each.converged]
    assert elsewhere
    for each in elsewhere:
        assert each.reason
        assert each.cost != linear.cost
        assert each.error_bars is None


def test_nothing_to_calibrate_is_refused_each_time() -> None:
    calibrator = Calibrator(stereo(6).dataset(), Options(hold=("world-left", "world-right")))
    for _ in range(2):
        with pytest.raises(UndeterminedError, match="nothing to calibrate"):
            calibrator.calibrate(StartingNoise())
