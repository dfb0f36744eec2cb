import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.coverage.formats import Rate


@pytest.mark.parametrize(
    ("rate", "percent", "text"),
    [
        (Rate(1, 3), 33.33, "33.3 % (1 of 3)"),
        (Rate(99999, 100000), 99.99, "99.9 % (99999 of 100000)"),  # not 100
        (Rate(5, 5), 100.0, "100.0 % (5 of 5)"),
        (Rate(0, 7), 0.0, "0.0 % (0 of 7)"),
        (Rate(), None, "-"),
    ],
)
def test_percent_is_rounded_down(rate: Rate, percent: float | None, text: str) -> None:
    assert rate.percent == percent
    assert str(rate) == text


@pytest.mark.parametrize(
    ("rate", "minimum", "reached"),
    [
        (Rate(4, 5), 80, True),
        (Rate(3999, 5000), 80, False),  # 79.98
        (Rate(0, 5), 0, True),
        (Rate(1, 3), 33.34, False),
        (Rate(0, 0), 0, False),  # of nothing
    ],
)
def test_a_limit_is_judged_exactly(rate: Rate, minimum: float, reached: bool) -> None:
    assert rate.reaches(minimum) is reached


@given(st.integers(1, 10**6).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_what_is_shown_never_promises_more_than_is(pair: tuple[int, int]) -> None:
    rate = Rate(*pair)
    assert rate.percent is not None
    assert rate.reaches(rate.percent)
    assert (rate.percent == 100) is (rate.covered == rate.total)
