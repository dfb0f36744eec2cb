import base64
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from calibration.base.text import Redactor


def redacted(secrets: list[str], chunks: list[bytes]) -> bytes:
    redactor = Redactor(secrets)
    return b"".join([*map(redactor.feed, chunks), redactor.close()])


SECRET = "hunter2-and-more"  # noqa: S105


@given(st.binary(max_size=30), st.binary(max_size=30), st.lists(st.integers(0, 80), max_size=6))
def test_no_cut_lets_a_secret_through(before: bytes, after: bytes, cuts: list[int]) -> None:
    whole = before + SECRET.encode() + after
    places = sorted({0, *(min(cut, len(whole)) for cut in cuts), len(whole)})
    chunks = [whole[a:b] for a, b in pairwise(places)]
    shown = redacted([SECRET], chunks)
    assert SECRET.encode() not in shown
    assert shown == whole.replace(SECRET.encode(), b"***")


def test_every_form() -> None:
    encoded = base64.b64encode(SECRET.encode())
    assert redacted([SECRET], [b"a " + encoded[:5], encoded[5:] + b" b"]) == b"a *** b"


def test_a_long_secret_whose_first_line_is_one_too() -> None:
    secret = "first line\nsecond line"  # noqa: S105
    assert redacted([secret], [b"x first line", b"\nsecond", b" line y"]) == b"x *** y"
    assert redacted([secret], [b"x first line", b"\nother"]) == b"x ***\nother"
    assert redacted([secret], [b"x first line"]) == b"x ***"


def test_other_text_is_shown_immediately() -> None:
    redactor = Redactor([SECRET])
    assert redactor.feed(b"progress 10%") == b"progress 10%"
    assert redactor.feed(b"an h") == b"an "  # may be its beginning
    assert redactor.feed(b"orse") == b"horse"
    assert Redactor([]).feed(b"x") == b"x"
    assert Redactor([" "]).close() == b""
