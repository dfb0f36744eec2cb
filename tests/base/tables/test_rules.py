import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.tables.rules import Limits, RuleSet

BOUNDS = st.none() | st.integers(-3, 3).map(float)
LIMITS = st.builds(Limits, BOUNDS, BOUNDS, st.booleans())
GRID = [x / 4 for x in range(-16, 17)]


def test_limits_are_inclusive_unless_told() -> None:
    assert Limits(0, 2).admit(0)
    assert Limits(0, 2).admit(2)
    assert not Limits(0, 2).admit(math.nextafter(2, 3))
    assert not Limits(0, 2, exclusive=True).admit(0)
    assert not Limits(0, 2, exclusive=True).admit(2)
    assert Limits(0, 2, exclusive=True).admit(math.nextafter(0, 1))


@given(LIMITS.filter(lambda limits: limits.minimum is not None or limits.maximum is not None))
def test_nan_is_never_admitted(limits: Limits) -> None:
    assert not limits.admit(math.nan)


@given(LIMITS, LIMITS)
def test_limits_contradict_each_other_when_no_number_is_within_both(first: Limits, second: Limits) -> None:
    """All limits here are whole numbers: where any number is within both, one of a fine grid is."""
    assert first.contradict(second) == (not any(first.admit(x) and second.admit(x) for x in GRID))


@given(LIMITS, st.floats(-4, 4), st.floats(0, 2))
def test_wider_limits_admit_no_less(limits: Limits, value: float, more: float) -> None:
    wider = Limits(
        None if limits.minimum is None else limits.minimum - more,
        None if limits.maximum is None else limits.maximum + more,
        limits.exclusive,
    )
    assert wider.admit(value) >= limits.admit(value)
    assert Limits(limits.minimum, limits.maximum, exclusive=False).admit(value) >= limits.admit(value)


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        (Limits(0, 3), "at least 0 and at most 3"),
        (Limits(0.5, None), "at least 0.5"),
        (Limits(None, 3, exclusive=True), "less than 3"),
        (Limits(1, 3, exclusive=True), "more than 1 and less than 3"),
    ],
)
def test_limits_in_words(limits: Limits, text: str) -> None:
    assert str(limits) == text


def test_what_is_said_later_overrides() -> None:
    first = RuleSet(key_column="a", min_rows=3, exclude_summary_rows=True)
    second = RuleSet(min_rows=5, exclude_summary_rows=False)
    assert first.overridden_by(second) == RuleSet(key_column="a", min_rows=5, exclude_summary_rows=False)


def test_summary_rows_are_excluded_on_request_only() -> None:
    assert RuleSet().excluded_rows == ()
    assert RuleSet(exclude_summary_rows=True).excluded_rows == ("Averages",)
    assert RuleSet(exclude_summary_rows=True, summary_rows=("Mean",)).excluded_rows == ("Mean",)
    assert RuleSet(summary_rows=("Mean",)).excluded_rows == ()
