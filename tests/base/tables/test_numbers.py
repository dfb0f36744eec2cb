import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import number_text, parse_number


@pytest.mark.parametrize(
    ("text", "number"),
    [("0", 0), ("-1.5", -1.5), ("+2", 2), (".5", 0.5), ("3.", 3), ("1e-3", 0.001), ("1E+2", 100), ("000", 0)],
)
def test_numbers(text: str, number: float) -> None:
    assert parse_number(text) == number


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nan",
        "NaN",
        "-nan",
        "inf",
        "-Infinity",
        "1e999",
        "1,5",
        "1_000",
        "0x1f",
        "1 2",
        " 1",
        "1\n",
        "\u0661",
        "\uff11",
        "1e",
        ".",
    ],
)
def test_what_only_looks_like_a_number(text: str) -> None:
    assert parse_number(text) is None


@given(st.floats())
def test_every_finite_float_reads_back(number: float) -> None:
    assert parse_number(repr(number)) == (number if math.isfinite(number) else None)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_number_text_keeps_all_digits(number: float) -> None:
    assert float(number_text(number)) == number


def test_number_text_is_short() -> None:
    assert [number_text(x) for x in (3.0, 0.1, 1e20, -0.5)] == ["3", "0.1", "1e+20", "-0.5"]
