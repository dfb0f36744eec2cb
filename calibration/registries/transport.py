"""HTTP to registries: tried again where that helps, bounded in time and size, no password to a stranger."""

import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from urllib.parse import urljoin, urlsplit

from calibration.errors import WorldError
from calibration.http import innermost_cause, no_other_password, retry_after
from calibration.registries.reference import is_loopback
from calibration.workflow import redact
from calibration.workflow.text import one_line, shorten

ATTEMPTS = 4
FIRST_PAUSE = 0.5
"""Seconds before the second attempt; doubled before each further one."""
LONGEST_PAUSE = 60.0
"""Seconds; where a registry asks for a longer one (``Retry-After``), the command ends instead."""
CONNECT_SECONDS, READ_SECONDS = 10.0, 30.0
MAX_BYTES = 4 * 1024 * 1024
"""Of an answer; registries take no larger manifest."""
_REDIRECTS = 5


@dataclass(frozen=True)
class Answer:
    """What a server answered."""

    status: int
    headers: Mapping[str, str]
    """Names in any case."""
    body: bytes


class Transport:
    """A session with servers."""

    def __init__(
        self,
        secrets: Iterable[str] = (),
        pause: Callable[[float], None] = time.sleep,
        seconds: tuple[float, float] = (CONNECT_SECONDS, READ_SECONDS),
    ) -> None:
        """Open a session.

        Args:
            secrets: what no message may quote; what is sent as authorization is never quoted.
            pause: waits for so many seconds between two attempts.
            seconds: to connect, and to wait for an answer.
        """
        import requests

        self._session = requests.Session()
        self._session.get_redirect_target = lambda _: None  # type: ignore  # see _follow
        self._secrets = set(secrets)
        self._pause = pause
        self._seconds = seconds

    def close(self) -> None:
        """End the session."""
        self._session.close()

    def send(self, method: str, url: str, headers: Mapping[str, str], body: bytes | None = None) -> Answer:
        """Send a request, again where it may pass then: no connection, 429, 5xx.

        Raises:
            WorldError: no answer after :data:`ATTEMPTS`, TLS that is not trusted, too large an answer, or a
                redirect that is not safe to follow.
        """
        import requests

        host = urlsplit(url).netloc
        if "Authorization" in headers:
            self._secrets.add(headers["Authorization"].partition(" ")[2])
        for attempt in range(ATTEMPTS):
            wait = FIRST_PAUSE * 2**attempt
            try:
                answer = self._follow(method, url, dict(headers), body)
            except requests.exceptions.SSLError as error:
                raise WorldError(f"{host}: its TLS is not trusted: {_reason(error)}") from None
            except (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError) as error:
                problem = f"no answer: {_reason(error)}"
            except (requests.RequestException, ValueError) as error:
                raise WorldError(f"{host}: {method} failed: {_reason(error)}") from None
            else:
                if answer.status != 429 and answer.status < 500:
                    return answer
                problem = f"answered {answer.status}{self.describe(answer)}"
                wait = retry_after(answer.headers.get("Retry-After", "")) or wait
                if wait > LONGEST_PAUSE:
                    raise WorldError(f"{host}: {problem}, and asks to come back in {wait:g} s")
            if attempt + 1 < ATTEMPTS:
                self._pause(wait)
        raise WorldError(f"{host}: {problem} ({ATTEMPTS} attempts)")

    def describe(self, answer: Answer) -> str:
        """What a registry says went wrong, to be put after the status; empty where it says it in no known form."""
        try:
            errors = json.loads(answer.body)["errors"]
            texts = [f"{error['code']}: {error.get('message') or ''}" for error in errors[:3]]
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return ""
        return f" ({shorten(one_line(redact('; '.join(texts), self._secrets)), 200)})" if texts else ""

    def _follow(self, method: str, url: str, headers: dict[str, str], body: bytes | None) -> Answer:
        """Send once, and go where the answer points to; another server is told no password."""
        for _ in range(_REDIRECTS + 1):
            answer = self._once(method, url, headers, body)
            if answer.status not in (301, 302, 303, 307, 308) or "Location" not in answer.headers:
                return answer
            host, target = urlsplit(url).netloc, urljoin(url, answer.headers["Location"])
            if method not in ("GET", "HEAD"):
                raise WorldError(f"{host}: sends a {method} on to {_shown(target)}, which is not followed")
            if urlsplit(target).scheme != "https" and urlsplit(target)[:2] != urlsplit(url)[:2]:
                raise WorldError(f"{host}: sends on to {_shown(target)}, which is not safe: https was expected")
            if urlsplit(target)[:2] != urlsplit(url)[:2]:
                headers = {name: value for name, value in headers.items() if name != "Authorization"}
            url = target
        raise WorldError(f"{urlsplit(url).netloc}: sends on and on (more than {_REDIRECTS} times)")

    def _once(self, method: str, url: str, headers: dict[str, str], body: bytes | None) -> Answer:
        proxies: dict[str, str | None] = {}
        if is_loopback(urlsplit(url).netloc):  # no proxy of the environment reaches this machine
            proxies = dict.fromkeys(("http", "https", "all"))
        with self._session.request(
            method,
            url,
            headers=headers,
            data=body,
            stream=True,
            allow_redirects=False,
            timeout=self._seconds,
            auth=no_other_password,
            proxies=proxies,  # type: ignore[arg-type]  # None: no proxy
        ) as response:
            content = bytearray()
            for chunk in response.iter_content(64 * 1024):
                content += chunk
                if len(content) > MAX_BYTES:
                    raise WorldError(f"{urlsplit(url).netloc}: answers with more than {MAX_BYTES} bytes")
            return Answer(response.status_code, response.headers, bytes(content))


def _reason(error: BaseException) -> str:
    """Why a request failed, in a line."""
    import requests

    if isinstance(error, requests.Timeout):
        return "no answer in time"
    return shorten(one_line(innermost_cause(error)), 200)


def _shown(url: str) -> str:
    """A URL without what may be secret in it."""
    parts = urlsplit(url)
    return shorten(one_line(f"{parts.scheme}://{parts.hostname or ''}"))
