import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.tables.rules import Allowance, parse_allowance


@pytest.mark.parametrize(
    ("text", "allowance"),
    [
        ("0.1", Allowance(0.1, False)),
        ("10%", Allowance(10, True)),
        (" 2.5 % ", Allowance(2.5, True)),
        ("0", Allowance(0, False)),
        ("1e-3", Allowance(0.001, False)),
    ],
)
def test_allowances(text: str, allowance: Allowance) -> None:
    assert parse_allowance(text) == allowance


@pytest.mark.parametrize("text", ["", "%", "-1", "-1%", "nan", "inf%", "1%%", "10 percent", "1e999"])
def test_what_is_no_allowance(text: str) -> None:
    with pytest.raises(InputError, match=r"give 0\.1 .* or 10%"):
        parse_allowance(text)


def test_allowances_are_as_exact_as_their_decimals() -> None:
    assert 0.7 + 0.1 != 0.8
    assert parse_allowance("0.1").above(0.7) == 0.8
    assert parse_allowance("0.1").below(0.3) == 0.2
    assert parse_allowance("10%").above(0.6004) == 0.66044
    assert parse_allowance("10%").below(0.5) == 0.45


def test_percentages_are_of_the_absolute_value() -> None:
    assert parse_allowance("10%").above(-2) == -1.8
    assert parse_allowance("10%").below(-2) == -2.2
    assert parse_allowance("10%").above(0) == 0


@given(st.floats(-1e300, 1e300), st.floats(0, 1e300), st.booleans())
def test_the_baseline_itself_is_always_allowed(baseline: float, amount: float, relative: bool) -> None:
    allowance = Allowance(amount, relative)
    assert allowance.below(baseline) <= baseline <= allowance.above(baseline)
