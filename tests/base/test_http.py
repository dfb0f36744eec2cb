"""HTTP independent of the server; retries and limits are tested with registries and Codacy."""

import pytest
import requests

from calibration.base import innermost_message
from calibration.base.http import is_loopback, retry_after


def test_the_cause_is_the_message_of_the_system() -> None:
    with pytest.raises(requests.ConnectionError) as refused:
        requests.get("http://127.0.0.1:9", timeout=5)  # nothing listens on the port "discard"
    assert innermost_message(refused.value) == "Connection refused"


def test_a_cause_without_words_is_named() -> None:
    assert innermost_message(requests.ConnectionError(ConnectionResetError())) == "ConnectionResetError"


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("", None),
        (" 12 ", 12.0),
        ("0", 0.0),
        ("Wed, 21 Oct 2026 07:28:00 GMT", None),
        ("-1", None),
        ("1e9", None),
        ("\N{SUPERSCRIPT TWO}", None),
        ("9" * 400, None),
    ],
)
def test_retry_after(header: str, seconds: float | None) -> None:
    assert retry_after(header) == seconds


@pytest.mark.parametrize(
    ("host", "there"),
    [
        ("127.0.0.1:5000", True),
        ("127.1.2.3", True),
        ("localhost", True),
        ("localhost:5000", True),
        ("[::1]:5000", True),
        ("ghcr.io", False),
        ("127.0.0.1.evil.org", False),
        ("127.0.0.1:5@evil.org", False),
        ("localhost.evil.org", False),
        ("[::1]@evil.org", False),
    ],
)
def test_which_host_is_this_machine(host: str, there: bool) -> None:
    assert is_loopback(host) is there
