"""What rooms that speak HTTP, by requests, share: why a request failed, how long to wait, whose password is sent."""

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import requests


def innermost_cause(error: BaseException) -> str:
    """The innermost cause of a failed request: what the system said, not which classes wrapped it."""
    seen: BaseException = error
    while True:
        inner = getattr(seen, "reason", None) or next((arg for arg in seen.args if isinstance(arg, Exception)), None)
        if not isinstance(inner, BaseException):
            break
        seen = inner
    text = getattr(seen, "strerror", None) or str(seen).rpartition(": ")[2] or type(seen).__name__
    return re.sub(r"^\[Errno -?[0-9]+\] ", "", text)


def retry_after(header: str) -> float | None:
    """Seconds that a server asks to wait (``Retry-After``); None where it asks nothing, or names a date."""
    text = header.strip()
    return float(text) if text.isascii() and text.isdigit() and len(text) < 10 else None


def no_other_password(request: "requests.PreparedRequest") -> "requests.PreparedRequest":
    """As ``auth``, leaves a request as it is: else the password of a .netrc goes to any server that it names."""
    return request
