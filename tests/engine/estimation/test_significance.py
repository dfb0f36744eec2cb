"""Standard scores agree with the standard library's."""

from statistics import NormalDist

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.estimation.covariance.significance import FAMILY_WISE, score_of_tail, threshold


@given(st.floats(-15, -0.302).map(lambda power: 10**power))
def test_a_score_is_exceeded_with_its_probability(probability: float) -> None:
    assert score_of_tail(probability) == pytest.approx(-NormalDist().inv_cdf(probability), rel=1e-12, abs=1e-12)


def test_more_tests_need_more_significance() -> None:
    assert threshold(0) == threshold(1) == pytest.approx(NormalDist().inv_cdf(1 - FAMILY_WISE))
    assert threshold(1) < threshold(2) < threshold(1000)
