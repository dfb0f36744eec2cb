"""Default limits are those of a good robot; what is not limited asks nothing."""

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import MAX_DEFAULT_LIMIT, MIN_DEFAULT_LIMIT, Allowed, Limits, allowed
from calibration.engine.estimation.calibrate import Options, calibrate
from tests.engine.estimation import systems


def arm(error: float = 0.0, pixel_noise: float = 0.1) -> Dataset:
    """An arm whose poses are off by so much along each axis, m."""
    dataset = systems.eye_to_hand(20, seed=1, pixel_noise=pixel_noise).dataset(1)
    poses = dataset.transforms["base", "flange"].copy()
    poses[:, :3, 3] += np.random.default_rng(3).normal(0, error, (20, 3))
    return dataset.with_transforms({("base", "flange"): poses})


def default_of(dataset: Dataset) -> Allowed:
    calibration = calibrate(dataset, Options())
    return allowed(calibration, Limits(), next(iter(dataset.sensors)))


def test_a_default_does_not_grow_with_what_is_wrong() -> None:
    good = default_of(arm())
    assert not good.set
    for bad in (default_of(arm(error=0.03)), default_of(arm(pixel_noise=8.0))):
        assert bad.translation_mm < 1.3 * default_of(arm(pixel_noise=0.35)).translation_mm
        assert bad.rotation_deg < 1.3 * default_of(arm(pixel_noise=0.35)).rotation_deg
    assert MIN_DEFAULT_LIMIT[0] <= good.translation_mm <= MAX_DEFAULT_LIMIT[0] * 3
    assert MIN_DEFAULT_LIMIT[1] <= good.rotation_deg <= MAX_DEFAULT_LIMIT[1]


@pytest.mark.parametrize(
    ("limits", "mm", "deg", "said"),
    [
        (Limits(translation_mm=2), 2, np.inf, "2 mm, none in deg"),
        (Limits(rotation_deg=0.1), np.inf, 0.1, "none in mm, 0.1 deg"),
        (Limits(joint_mm=1), np.inf, np.inf, "none in mm, none in deg"),
    ],
)
def test_a_limit_that_is_not_given_asks_nothing(limits: Limits, mm: float, deg: float, said: str) -> None:
    found = allowed(calibrate(arm(), Options()), limits, "cam")
    assert (found.translation_mm, found.rotation_deg, str(found)) == (mm, deg, said)
    assert not found.exceeded(mm if mm < np.inf else 1e9, deg if deg < np.inf else 180)
