"""Numbers as people read them in messages."""

import pytest

from calibration.base import not_a_number, rounded, with_error_bar


@pytest.mark.parametrize(
    ("number", "digits", "text"), [(268.4, 2, "270"), (0.01234, 2, "0.012"), (9.96, 1, "10"), (-5432.0, 1, "-5000")]
)
def test_no_number_of_a_usual_size_has_an_exponent(number: float, digits: int, text: str) -> None:
    assert rounded(number, digits) == text


def test_an_error_bar_has_one_digit() -> None:
    assert with_error_bar(5.312, 12.3) == "5.31 ± 10"


def test_a_decimal_comma_is_named_and_nothing_else_is_one() -> None:
    assert "decimal comma" in not_a_number("0,42")
    assert not any("decimal comma" in not_a_number(text) for text in ("abc", "nan", "1,2,3", "0x1f"))
