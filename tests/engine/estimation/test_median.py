"""The median against numpy's, also where a sample tells badly where it is."""

import numpy as np
import pytest

from calibration.engine.estimation.residuals.median import MIN_NUMBERS_TO_NARROW, median

RNG = np.random.default_rng(0)
NUMBERS = {
    "one": np.ones(1),
    "two": np.array([3.0, 1.0]),
    "odd": RNG.normal(size=(7, 11)),
    "many": RNG.chisquare(2, 3 * MIN_NUMBERS_TO_NARROW),
    "many, even": RNG.normal(size=2 * MIN_NUMBERS_TO_NARROW + 2),
    "ties": RNG.integers(0, 3, 2 * MIN_NUMBERS_TO_NARROW).astype(float),
    "all equal": np.full(2 * MIN_NUMBERS_TO_NARROW, 0.25),
    "sorted": np.arange(2 * MIN_NUMBERS_TO_NARROW + 1.0),
    "outliers": np.where(RNG.random(2 * MIN_NUMBERS_TO_NARROW) < 0.49, 1e12, RNG.random(2 * MIN_NUMBERS_TO_NARROW)),
    "sampled badly": np.where(
        np.arange(2 * MIN_NUMBERS_TO_NARROW) % 50 == 0, 100.0, RNG.random(2 * MIN_NUMBERS_TO_NARROW)
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_it_is_numpys(name: str) -> None:
    numbers = NUMBERS[name]
    kept = numbers.copy()
    assert median(numbers) == np.median(numbers)
    np.testing.assert_array_equal(numbers, kept)


def test_of_no_numbers_there_is_none() -> None:
    assert np.isnan(median(np.zeros(0)))
