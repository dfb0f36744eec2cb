"""HTTP client for untrusted servers: limited in time and size, with retries, credentials only to the server named.

The retries are our own, because urllib3's ``Retry`` does not repeat a request whose answer breaks off, waits as long
as a server asks for, and has no limit for a whole attempt, so that one byte every few seconds keeps it waiting.
"""

import queue
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urljoin, urlsplit

from calibration.base.errors import InfrastructureError, innermost_message
from calibration.base.text import count_of, one_line, redact, shorten

if TYPE_CHECKING:
    import requests

MAX_ATTEMPTS = 4
FIRST_PAUSE = 0.5
"""Seconds before the second attempt; doubled before each further one."""
LONGEST_PAUSE = 60.0
"""Seconds; if a server asks for a longer pause (``Retry-After``), the request fails instead."""
MAX_BYTES = 4 * 1024 * 1024
"""Maximum size of an answer; registries accept no larger manifest."""
_MAX_REDIRECTS = 5
_LOOPBACK_HOST = re.compile(r"(localhost|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]+)?")


@dataclass(frozen=True)
class Timeouts:
    """Timeouts in seconds."""

    connect: float = 10.0
    silence: float = 30.0
    """Longest wait for the next bytes of the answer."""
    whole: float = 90.0
    """Whole attempt, from the connection to the end of the answer."""


@dataclass(frozen=True)
class Answer:
    """A server's answer."""

    status: int
    headers: Mapping[str, str]
    """Headers by name, in any case."""
    body: bytes

    @property
    def content_type(self) -> str:
        """Media type in lower case, without parameters; empty if the server names none."""
        return self.headers.get("Content-Type", "").partition(";")[0].strip().lower()


class _NoAnswerError(Exception):
    """A failed attempt that may be repeated; the message is the cause."""


def beginning(body: bytes) -> str:
    """Return the beginning of an answer's text; empty for a page of HTML."""
    text = one_line(body[:2000].decode("utf-8", "replace"))
    return "" if "<" in text[:50] else text


class Http:
    """Session of HTTP requests."""

    def __init__(
        self,
        secrets: Iterable[str] = (),
        *,
        address: str = "its address",
        explain: Callable[[bytes], str] = beginning,
        timeouts: Timeouts | None = None,
        most_bytes: int = MAX_BYTES,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Open a session.

        Args:
            secrets: strings that are redacted in every message; values of Authorization headers are added.
            address: setting with the server's address, for messages.
            explain: returns the error message in the body of an answer.
            timeouts: timeouts of an attempt.
            most_bytes: maximum size of an answer.
            pause: sleeps for a number of seconds between two attempts.
        """
        import requests

        self._session = requests.Session()
        self._errors = requests.exceptions
        self._session.get_redirect_target = lambda _: None  # type: ignore  # see _follow
        self._secrets = set(secrets)
        self._address = address
        self._explain = explain
        self._timeouts = timeouts or Timeouts()
        self._most_bytes = most_bytes
        self._pause = pause

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def send(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None = None) -> Answer:
        """Send a request, with up to `MAX_ATTEMPTS` attempts if there is no answer, or 429 or 5xx.

        Raises:
            InfrastructureError: no attempt was answered, TLS is not trusted, the answer is too large, or it redirects
                to an unsafe address.
        """
        host = urlsplit(url).netloc
        if "Authorization" in headers:
            self._secrets.add(headers["Authorization"].partition(" ")[2])
        for attempt in range(1, MAX_ATTEMPTS + 1):
            wait = FIRST_PAUSE * 2 ** (attempt - 1)
            attempts = count_of(attempt, "attempt")
            try:
                answer = self._send_within_time(method, url, headers, body)
            except _NoAnswerError as error:
                problem = str(error)
                advice = f"check the network, a proxy (HTTPS_PROXY) and {self._address}, or run it again"
            else:
                if answer.status != 429 and answer.status < 500:
                    return answer
                problem = f"answered {answer.status}{self.quote(answer.body)}"
                busy = "too many requests" if answer.status == 429 else "the server failed"
                advice = f"{busy}: run it again later"
                asked = retry_after(answer.headers.get("Retry-After", ""))
                wait = wait if asked is None else asked
                if wait > LONGEST_PAUSE:
                    raise InfrastructureError(
                        f"{host}: {problem} and asks for a pause of {wait:g} s ({attempts}): {advice}"
                    )
            if attempt < MAX_ATTEMPTS:
                self._pause(wait)
        raise InfrastructureError(f"{host}: {problem} ({attempts}): {advice}")

    def quote(self, body: bytes) -> str:
        """Return the server's error message in brackets, to be appended to the status; empty if there is none."""
        text = one_line(redact(self._explain(body), self._secrets))
        return f" ({shorten(text, 200)})" if text else ""

    def _send_within_time(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        """Send once with a timeout for the whole: in a thread, because each byte restarts the timeout of a socket."""
        answers: queue.SimpleQueue[Answer | Exception] = queue.SimpleQueue()

        def attempt() -> None:
            try:
                answers.put(self._follow_redirects(method, url, headers, body))
            except Exception as error:
                answers.put(error)

        threading.Thread(target=attempt, daemon=True, name="http").start()
        try:
            answer = answers.get(timeout=self._timeouts.whole)
        except queue.Empty:
            raise _NoAnswerError(f"did not finish its answer within {self._timeouts.whole:g} s") from None
        if isinstance(answer, Exception):
            raise self._explain_failure(answer, urlsplit(url).netloc)
        return answer

    def _follow_redirects(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        """Send once and follow redirects; credentials are not sent to another server."""
        for _ in range(_MAX_REDIRECTS + 1):
            answer = self._send_once(method, url, headers, body)
            if answer.status not in (301, 302, 303, 307, 308) or "Location" not in answer.headers:
                return answer
            target = urljoin(url, answer.headers["Location"])
            same = urlsplit(target)[:2] == urlsplit(url)[:2]
            sends = f"{urlsplit(url).netloc}: answered {answer.status}: redirects a {method} to {_without_path(target)}"
            if method not in ("GET", "HEAD"):
                raise InfrastructureError(f"{sends}, which is not followed: check {self._address}")
            if urlsplit(target).scheme != "https" and not same:
                raise InfrastructureError(f"{sends}, which is unencrypted: https was expected")
            if not same:
                headers = {name: value for name, value in headers.items() if name != "Authorization"}
            url = target
        raise InfrastructureError(f"{urlsplit(url).netloc}: redirects more than {_MAX_REDIRECTS} times")

    def _send_once(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        proxies: dict[str, str | None] = {}
        if is_loopback(urlsplit(url).netloc):  # a proxy of the environment cannot reach this machine
            proxies = dict.fromkeys(("http", "https", "all"))
        with self._session.request(
            method,
            url,
            headers=dict(headers),
            data=body,
            stream=True,
            allow_redirects=False,
            timeout=(self._timeouts.connect, self._timeouts.silence),
            auth=_no_other_password,
            proxies=proxies,  # type: ignore[arg-type]  # None: no proxy
        ) as response:
            content = bytearray()
            for chunk in response.iter_content(64 * 1024):
                content += chunk
                if len(content) > self._most_bytes:
                    raise InfrastructureError(
                        f"{urlsplit(url).netloc}: answers with more than {self._most_bytes} bytes"
                    )
            return Answer(response.status_code, response.headers, bytes(content))

    def _explain_failure(self, error: Exception, host: str) -> Exception:
        """Return the exception to raise for a failed attempt."""
        if isinstance(error, InfrastructureError):
            return error
        reason = shorten(one_line(redact(innermost_message(error), self._secrets)), 200)
        if isinstance(error, self._errors.SSLError):
            ca = "a proxy's own certificate: REQUESTS_CA_BUNDLE"
            return InfrastructureError(f"{host}: its TLS is not trusted: {reason} ({ca})")
        if isinstance(error, self._errors.ConnectTimeout):
            return _NoAnswerError(f"no connection within {self._timeouts.connect:g} s")
        if isinstance(error, self._errors.Timeout) or "timed out" in reason:
            return _NoAnswerError(f"no answer within {self._timeouts.silence:g} s")
        if isinstance(error, self._errors.ChunkedEncodingError):
            return _NoAnswerError(f"broke off in the middle of its answer: {reason}")
        if isinstance(error, self._errors.ConnectionError):
            return _NoAnswerError(f"no answer: {reason}")
        return InfrastructureError(f"{host}: the request failed: {reason}")


def is_loopback(netloc: str) -> bool:
    """Whether a host, with or without port, is this machine: no proxy is used for it, and it may lack TLS."""
    return _LOOPBACK_HOST.fullmatch(netloc) is not None


def retry_after(header: str) -> float | None:
    """Parse ``Retry-After``: seconds to wait; None if it is empty or a date."""
    text = header.strip()
    return float(text) if text.isascii() and text.isdigit() and len(text) < 10 else None


def _no_other_password(request: "requests.PreparedRequest") -> "requests.PreparedRequest":
    """Do nothing, as ``auth`` of requests: otherwise requests would send passwords of ~/.netrc."""
    return request


def _without_path(url: str) -> str:
    """Return scheme and host of a URL; the rest may contain secrets."""
    parts = urlsplit(url)
    return shorten(one_line(f"{parts.scheme}://{parts.hostname or ''}"))
