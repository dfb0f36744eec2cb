"""Rates of failures: known intervals, and their law."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta

from calibration.base.verdict import FlakeRate, rate_seen_by, runs_to_see


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(("failed", "runs"), [(3, 60), (0, 10), (10, 10), (1, 2), (999, 1000)])
def test_intervals_are_those_of_clopper_and_pearson(failed: int, runs: int) -> None:
    low = beta.ppf(0.025, failed, runs - failed + 1) if failed else 0
    high = beta.ppf(0.975, failed + 1, runs - failed) if failed < runs else 1
    assert FlakeRate(failed, runs).interval == pytest.approx((low, high), abs=1e-6)


@given(st.integers(1, 200), st.data())
def test_the_share_lies_in_its_interval(runs: int, data: st.DataObject) -> None:
    failed = data.draw(st.integers(0, runs))
    low, high = FlakeRate(failed, runs).interval
    assert 0 <= low <= failed / runs <= high <= 1


def test_it_is_said_as_a_person_reads_it() -> None:
    assert str(FlakeRate(3, 60)) == "failed 3 of 60: between 1 and 14 % of runs at 95 %"


def test_a_flake_of_five_percent_shows_in_59_runs() -> None:
    assert (runs_to_see(0.05), runs_to_see(1)) == (59, 1)
    assert rate_seen_by(59) < 0.05 < rate_seen_by(58)
    draws = random.Random(1)
    seen = sum(any(draws.random() < 0.05 for _ in range(60)) for _ in range(2000))
    assert seen >= 0.94 * 2000
