"""Median, and standard scores of statistics."""

from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.statistics import (
    FAMILY_WISE,
    median,
    score_of_tail,
    threshold,
)

RNG = np.random.default_rng(0)
NUMBERS = {
    "one": np.ones(1),
    "two": np.array([3.0, 1.0]),
    "odd": RNG.normal(size=(7, 11)),
    "many": RNG.chisquare(2, 3 * 10_000),
    "many, even": RNG.normal(size=2 * 10_000 + 2),
    "ties": RNG.integers(0, 3, 2 * 10_000).astype(float),
    "all equal": np.full(2 * 10_000, 0.25),
    "sorted": np.arange(2 * 10_000 + 1.0),
    "outliers": np.where(RNG.random(2 * 10_000) < 0.49, 1e12, RNG.random(2 * 10_000)),
    "sampled badly": np.where(np.arange(2 * 10_000) % 50 == 0, 100.0, RNG.random(2 * 10_000)),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_it_is_numpys(name: str) -> None:
    numbers = NUMBERS[name]
    kept = numbers.copy()
    assert median(numbers) == np.median(numbers)
    np.testing.assert_array_equal(numbers, kept)


def test_of_no_numbers_there_is_none() -> None:
    assert np.isnan(median(np.zeros(0)))


@given(st.floats(-15, -0.302).map(lambda power: 10**power))
def test_a_score_is_exceeded_with_its_probability(probability: float) -> None:
    assert score_of_tail(probability) == pytest.approx(-NormalDist().inv_cdf(probability), rel=1e-12, abs=1e-12)


def test_more_tests_need_more_significance() -> None:
    assert threshold(0) == threshold(1) == pytest.approx(NormalDist().inv_cdf(1 - FAMILY_WISE))
    assert threshold(1) < threshold(2) < threshold(1000)
