"""A POST to a service: bounded in time and size, tried again where that helps, with an error that says what to do."""

import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from urllib.parse import urlsplit

from calibration.coverage.services.service import Request
from calibration.errors import WorldError
from calibration.http import innermost_cause, no_other_password, retry_after
from calibration.workflow import redact
from calibration.workflow.text import one_line, shorten

ATTEMPTS = 3
"""In all."""
FIRST_PAUSE = 1.0
"""Seconds before the second attempt; doubled before each further one."""
LONGEST_PAUSE = 60.0
"""Seconds; where a service asks for a longer one (``Retry-After``), it is not waited for."""
MAX_BYTES = 1024 * 1024
"""Of an answer."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


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
    content_type: str
    body: bytes
    retry_after: float | None = None
    """Seconds that it asks to wait."""
    location: str = ""


class _NoAnswerError(Exception):
    """An attempt that may be repeated; the message says what happened."""


class Poster:
    """Sends requests."""

    def __init__(
        self, secrets: Iterable[str] = (), limits: Limits | None = None, pause: Callable[[float], None] = time.sleep
    ) -> None:
        """Prepare to send.

        Args:
            secrets: what no message may quote.
            limits: of the time that it may take.
            pause: waits for so many seconds between two attempts.
        """
        self._secrets = tuple(secrets)
        self._limits = limits or Limits()
        self._pause = pause

    def post(self, request: Request) -> Answer:
        """Send a request; again, up to :data:`ATTEMPTS`, where there is no answer, or 429 or 5xx.

        Raises:
            WorldError: none of the attempts was answered, TLS is not trusted, or the answer is too large.
        """
        host = urlsplit(request.url).netloc
        problem = ""
        for attempt in range(ATTEMPTS):
            wait = FIRST_PAUSE * 2**attempt
            try:
                answer = self._bounded(request)
            except _NoAnswerError as error:
                problem = f"{error}"
                advice = "check the network, a proxy (HTTPS_PROXY) and the address (api-url), or run the job again"
            else:
                if answer.status != 429 and answer.status < 500:
                    return answer
                problem = f"answered {answer.status}{self.quote(answer.body)}"
                advice = (
                    "it has had too many requests: run the job again later"
                    if answer.status == 429
                    else "the fault is on its side: run the job again later"
                )
                wait = wait if answer.retry_after is None else answer.retry_after
                if wait > LONGEST_PAUSE:
                    attempts = f"{attempt + 1} attempt{'s' if attempt else ''}"
                    raise WorldError(f"{host}: {problem} and asks to come back in {wait:g} s ({attempts}): {advice}")
            if attempt + 1 < ATTEMPTS:
                self._pause(wait)
        raise WorldError(f"{host}: {problem} ({ATTEMPTS} attempts): {advice}")

    def quote(self, body: bytes) -> str:
        """The beginning of an answer for a message, without secrets; nothing of one that is no text."""
        text = one_line(redact(body[:2000].decode("utf-8", "replace"), self._secrets))
        return f" ({shorten(text, 200)})" if text and "<" not in text[:50] else ""

    def _bounded(self, request: Request) -> Answer:
        """Send once, within the time for it: in a thread, because a server may always send one more byte in time."""
        answers: queue.SimpleQueue[Answer | Exception] = queue.SimpleQueue()

        def attempt() -> None:
            try:
                answers.put(self._once(request))
            except Exception as error:
                answers.put(error)

        threading.Thread(target=attempt, daemon=True, name="upload").start()
        try:
            answer = answers.get(timeout=self._limits.whole)
        except queue.Empty:
            raise _NoAnswerError(f"did not finish its answer within {self._limits.whole:g} s") from None
        if isinstance(answer, Exception):
            raise self._explained(answer, urlsplit(request.url).netloc)
        return answer

    def _once(self, request: Request) -> Answer:
        import requests

        with requests.Session() as session:
            if urlsplit(request.url).hostname in _LOOPBACK:
                session.trust_env = False  # no proxy of the environment reaches this machine
            with session.post(
                request.url,
                data=request.body,
                headers=dict(request.headers),
                timeout=(self._limits.connect, self._limits.silence),
                allow_redirects=False,  # the token is for this server alone
                auth=no_other_password,
                stream=True,
            ) as response:
                content = bytearray()
                for chunk in response.iter_content(64 * 1024):
                    content += chunk
                    if len(content) > MAX_BYTES:
                        raise WorldError(f"{urlsplit(request.url).netloc}: answers with more than {MAX_BYTES} bytes")
                headers = response.headers
                return Answer(
                    response.status_code,
                    headers.get("Content-Type", "").partition(";")[0].strip().lower(),
                    bytes(content),
                    retry_after(headers.get("Retry-After", "")),
                    headers.get("Location", ""),
                )

    def _explained(self, error: Exception, host: str) -> Exception:
        """What to raise for what went wrong in an attempt."""
        import requests

        if isinstance(error, WorldError):
            return error
        reason = shorten(one_line(redact(innermost_cause(error), self._secrets)), 200)
        if isinstance(error, requests.exceptions.SSLError):
            return WorldError(
                f"{host}: its TLS is not trusted: {reason} (a proxy's own certificate: REQUESTS_CA_BUNDLE)"
            )
        if isinstance(error, requests.ConnectTimeout):
            return _NoAnswerError(f"no connection within {self._limits.connect:g} s")
        if isinstance(error, requests.Timeout) or "timed out" in reason:
            return _NoAnswerError(f"no answer within {self._limits.silence:g} s")
        if isinstance(error, requests.exceptions.ChunkedEncodingError):
            return _NoAnswerError(f"broke off in the middle of its answer: {reason}")
        if isinstance(error, requests.ConnectionError):
            return _NoAnswerError(f"no answer: {reason}")
        return WorldError(f"{host}: the request failed: {reason}")
