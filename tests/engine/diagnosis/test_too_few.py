"""Few collections of an arm: undecided where they disagree, as one of them then decides the result."""

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.too_few import too_few
from calibration.engine.estimation.calibrate import calibrate
from tests.engine.estimation.systems import eye_to_hand, stereo


def arm(collections: int, error: float) -> Dataset:
    """An arm whose poses are off by so much, m and rad."""
    dataset = eye_to_hand(collections, pixel_noise=0.1).dataset()
    poses = dataset.transforms["base", "flange"].copy()
    poses[:, :3, 3] += np.random.default_rng(3).normal(0, error, (collections, 3))
    return dataset.with_transforms({("base", "flange"): poses})


@pytest.mark.parametrize("collections", [3, 5, 6])
def test_few_that_disagree_are_undecided(collections: int) -> None:
    [found] = too_few(calibrate(arm(collections, 0.005)))
    assert (found.kind, found.severity) == ("too-few", "undecided")
    assert found.text.startswith(f"{collections} collections are too few")


@pytest.mark.parametrize("dataset", [arm(4, 0.0), arm(10, 0.005), stereo(4, pixel_noise=0.1).dataset()])
def test_few_that_agree_and_enough_are_not(dataset: Dataset) -> None:
    assert not too_few(calibrate(dataset))
