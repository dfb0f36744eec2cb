"""HTTP to servers of others: bounded in time and size, repeated where that can help, no secret to another server.

The loop over attempts is our own. urllib3's ``Retry`` does not repeat a request whose answer breaks off, waits as long
as a server asks for, and has no bound for an attempt as a whole, so that one byte every few seconds holds it for ever.
"""

import queue
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urljoin, urlsplit

from calibration.errors import InfrastructureError
from calibration.workflow import redact
from calibration.workflow.text import one_line, shorten

if TYPE_CHECKING:
    import requests

ATTEMPTS = 4
FIRST_PAUSE = 0.5
"""Seconds before the second attempt; doubled before each further one."""
LONGEST_PAUSE = 60.0
"""Seconds; a server that asks for a longer pause (``Retry-After``) is not waited for."""
MAX_BYTES = 4 * 1024 * 1024
"""Of an answer; registries take no larger manifest."""
_REDIRECTS = 5
_LOOPBACK = re.compile(r"(localhost|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]+)?")


@dataclass(frozen=True)
class Limits:
    """How long things may take, in seconds."""

    connect: float = 10.0
    silence: float = 30.0
    """Until the server says something, or something more."""
    whole: float = 90.0
    """One attempt."""


@dataclass(frozen=True)
class Answer:
    """What a server answered."""

    status: int
    headers: Mapping[str, str]
    """Names in any case."""
    body: bytes

    @property
    def content_type(self) -> str:
        """Media type in lower case, without parameters; empty if the server names none."""
        return self.headers.get("Content-Type", "").partition(";")[0].strip().lower()


class _NoAnswerError(Exception):
    """An attempt that may be repeated; the message says what happened."""


def beginning(body: bytes) -> str:
    """Beginning of an answer's text; empty for a page of HTML."""
    text = one_line(body[:2000].decode("utf-8", "replace"))
    return "" if "<" in text[:50] else text


class Http:
    """Session with servers."""

    def __init__(
        self,
        secrets: Iterable[str] = (),
        *,
        address: str = "its address",
        explain: Callable[[bytes], str] = beginning,
        limits: Limits | None = None,
        most_bytes: int = MAX_BYTES,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Open a session.

        Args:
            secrets: hidden in every message, as is what is sent as authorization.
            address: what tells us the server's address, for messages.
            explain: finds in the body of an answer what the server says went wrong.
            limits: of the time that an attempt may take.
            most_bytes: of an answer.
            pause: waits for so many seconds between two attempts.
        """
        import requests

        self._session = requests.Session()
        self._errors = requests.exceptions
        self._session.get_redirect_target = lambda _: None  # type: ignore  # see _follow
        self._secrets = set(secrets)
        self._address = address
        self._explain = explain
        self._limits = limits or Limits()
        self._most_bytes = most_bytes
        self._pause = pause

    def close(self) -> None:
        """End the session."""
        self._session.close()

    def send(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None = None) -> Answer:
        """Send a request; again, up to `ATTEMPTS`, where there is no answer, or 429 or 5xx.

        Raises:
            InfrastructureError: no attempt was answered, TLS is not trusted, the answer is too large, or it redirects
                to where it is not safe to follow.
        """
        host = urlsplit(url).netloc
        if "Authorization" in headers:
            self._secrets.add(headers["Authorization"].partition(" ")[2])
        for attempt in range(1, ATTEMPTS + 1):
            wait = FIRST_PAUSE * 2 ** (attempt - 1)
            attempts = f"{attempt} attempt{'s' if attempt > 1 else ''}"
            try:
                answer = self._bounded(method, url, headers, body)
            except _NoAnswerError as error:
                problem = str(error)
                advice = f"check the network, a proxy (HTTPS_PROXY) and {self._address}, or run it again"
            else:
                if answer.status != 429 and answer.status < 500:
                    return answer
                problem = f"answered {answer.status}{self.quote(answer.body)}"
                busy = "it has had too many requests" if answer.status == 429 else "the fault is on its side"
                advice = f"{busy}: run it again later"
                asked = retry_after(answer.headers.get("Retry-After", ""))
                wait = wait if asked is None else asked
                if wait > LONGEST_PAUSE:
                    raise InfrastructureError(
                        f"{host}: {problem} and asks to come back in {wait:g} s ({attempts}): {advice}"
                    )
            if attempt < ATTEMPTS:
                self._pause(wait)
        raise InfrastructureError(f"{host}: {problem} ({attempts}): {advice}")

    def quote(self, body: bytes) -> str:
        """What an answer says, in brackets, to stand after its status in a message; empty if it says nothing."""
        text = one_line(redact(self._explain(body), self._secrets))
        return f" ({shorten(text, 200)})" if text else ""

    def _bounded(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        """Send once, within the time for it: in a thread, because a server may always send one more byte in time."""
        answers: queue.SimpleQueue[Answer | Exception] = queue.SimpleQueue()

        def attempt() -> None:
            try:
                answers.put(self._follow(method, url, headers, body))
            except Exception as error:
                answers.put(error)

        threading.Thread(target=attempt, daemon=True, name="http").start()
        try:
            answer = answers.get(timeout=self._limits.whole)
        except queue.Empty:
            raise _NoAnswerError(f"did not finish its answer within {self._limits.whole:g} s") from None
        if isinstance(answer, Exception):
            raise self._explained(answer, urlsplit(url).netloc)
        return answer

    def _follow(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        """Send once, and go where the answer points to; another server gets no password."""
        for _ in range(_REDIRECTS + 1):
            answer = self._once(method, url, headers, body)
            if answer.status not in (301, 302, 303, 307, 308) or "Location" not in answer.headers:
                return answer
            target = urljoin(url, answer.headers["Location"])
            same = urlsplit(target)[:2] == urlsplit(url)[:2]
            sends = f"{urlsplit(url).netloc}: answered {answer.status}: sends a {method} on to {_shown(target)}"
            if method not in ("GET", "HEAD"):
                raise InfrastructureError(f"{sends}, which is not followed: check {self._address}")
            if urlsplit(target).scheme != "https" and not same:
                raise InfrastructureError(f"{sends}, which is not safe: https was expected")
            if not same:
                headers = {name: value for name, value in headers.items() if name != "Authorization"}
            url = target
        raise InfrastructureError(f"{urlsplit(url).netloc}: sends on and on (more than {_REDIRECTS} times)")

    def _once(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None) -> Answer:
        proxies: dict[str, str | None] = {}
        if is_loopback(urlsplit(url).netloc):  # no proxy of the environment reaches this machine
            proxies = dict.fromkeys(("http", "https", "all"))
        with self._session.request(
            method,
            url,
            headers=dict(headers),
            data=body,
            stream=True,
            allow_redirects=False,
            timeout=(self._limits.connect, self._limits.silence),
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

    def _explained(self, error: Exception, host: str) -> Exception:
        """What to raise for what went wrong in an attempt."""
        if isinstance(error, InfrastructureError):
            return error
        reason = shorten(one_line(redact(innermost_cause(error), self._secrets)), 200)
        if isinstance(error, self._errors.SSLError):
            ca = "a proxy's own certificate: REQUESTS_CA_BUNDLE"
            return InfrastructureError(f"{host}: its TLS is not trusted: {reason} ({ca})")
        if isinstance(error, self._errors.ConnectTimeout):
            return _NoAnswerError(f"no connection within {self._limits.connect:g} s")
        if isinstance(error, self._errors.Timeout) or "timed out" in reason:
            return _NoAnswerError(f"no answer within {self._limits.silence:g} s")
        if isinstance(error, self._errors.ChunkedEncodingError):
            return _NoAnswerError(f"broke off in the middle of its answer: {reason}")
        if isinstance(error, self._errors.ConnectionError):
            return _NoAnswerError(f"no answer: {reason}")
        return InfrastructureError(f"{host}: the request failed: {reason}")


def is_loopback(netloc: str) -> bool:
    """Whether a host, with or without port, is this machine: no proxy is asked for it, and it may lack TLS."""
    return _LOOPBACK.fullmatch(netloc) is not None


def retry_after(header: str) -> float | None:
    """Seconds that a server asks to wait (``Retry-After``); None where it asks nothing, or names a date."""
    text = header.strip()
    return float(text) if text.isascii() and text.isdigit() and len(text) < 10 else None


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


def _no_other_password(request: "requests.PreparedRequest") -> "requests.PreparedRequest":
    """As ``auth``, leaves a request as it is: else the password of a .netrc goes to any server that it names."""
    return request


def _shown(url: str) -> str:
    """A URL without what may be secret in it."""
    parts = urlsplit(url)
    return shorten(one_line(f"{parts.scheme}://{parts.hostname or ''}"))
