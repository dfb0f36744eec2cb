"""One problem for calibrations from many initial guesses: the same results, to the last bit, as with one for each."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import UndeterminedError
from calibration.estimation.calibrate import Options, calibrate, setup_of
from calibration.estimation.starting_noise import StartingNoise
from tests.estimation.systems import camera_and_lidar, stereo

SCENES = {"cameras": stereo(8), "LiDAR": camera_and_lidar(8)}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("start", ["linear", "given"])
def test_a_shared_setup_changes_nothing(name: str, start: str) -> None:
    dataset = replace(SCENES[name], pixel_noise=0.3, range_noise=0.005).dataset()
    options = Options(start=start)  # type: ignore[arg-type]
    setup = setup_of(dataset, options)
    for seed, loss in ((1, "huber"), (2, "linear"), (3, "huber")):
        noise, each = StartingNoise(0.05, 0.05, seed), replace(options, loss=loss)  # type: ignore[arg-type]
        shared, alone = calibrate(dataset, each, noise, setup), calibrate(dataset, each, noise)
        assert shared.converged == alone.converged
        assert shared.cost == alone.cost
        for edge, T in alone.transforms.items():
            np.testing.assert_array_equal(shared.transforms[edge], T)
        for edge, covariance in alone.covariances.items():
            np.testing.assert_array_equal(shared.covariances[edge], covariance)


def test_a_setup_of_nothing_to_calibrate_is_refused() -> None:
    dataset = stereo(6).dataset()
    with pytest.raises(UndeterminedError, match="nothing to calibrate"):
        setup_of(dataset, Options(hold=("world-left", "world-right")))
