import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.execution.job import describe_bytes, parse_bytes, parse_seconds


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (1024, 1024),
        ("1", 1),
        ("2g", 2 * 1024**3),
        ("512 MiB", 512 * 1024**2),
        ("512MB", 512 * 1024**2),
        ("1.5k", 1536),
        (" 1T ", 1024**4),
    ],
)
def test_bytes(text: object, expected: int) -> None:
    assert parse_bytes(text, "memory") == expected


@pytest.mark.parametrize(
    "text", ["", "0", 0, -1, "-1g", "2 gigs", "1e3", True, None, [], "9" * 200, "g", "1 2g", "inf"]
)
def test_no_bytes(text: object) -> None:
    with pytest.raises(InputError, match=r"^memory: found .*, expected a size such as"):
        parse_bytes(text, "memory")


@pytest.mark.parametrize(
    ("text", "expected"),
    [(45, 45), ("45", 45), (0.5, 0.5), ("90s", 90), ("10m", 600), ("1h30m", 5400), ("1.5h", 5400), ("500ms", 0.5)],
)
def test_seconds(text: object, expected: float) -> None:
    assert parse_seconds(text, "timeout") == expected


@pytest.mark.parametrize("text", ["", 0, "0s", -1, "-5m", "1x", "1h 30", "nan", math.inf, math.nan, "400d", True, None])
def test_no_seconds(text: object) -> None:
    with pytest.raises(InputError, match=r"^timeout: found .*, expected a time such as"):
        parse_seconds(text, "timeout")


@given(st.text() | st.floats() | st.integers())
def test_anything_is_an_amount_or_an_error(value: object) -> None:
    for parse in (parse_bytes, parse_seconds):
        try:
            assert 0 < parse(value, "key") < math.inf
        except InputError:
            continue


def test_described() -> None:
    assert describe_bytes(64 * 1024**2) == "64 MiB"
    assert describe_bytes(10) == "10 bytes"
    assert describe_bytes(3 * 1024**5) == "3072 TiB"
