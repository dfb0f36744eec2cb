"""GitHub's REST API: JSON requests, paginated lists, and error messages for users.

https://docs.github.com/en/rest
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Self
from urllib.parse import urlsplit

from calibration.base import InfrastructureError, InputError
from calibration.base.http import Answer, Http, is_loopback

API_URL = "https://api.github.com"
MAX_ANSWER_BYTES = 64 * 1024**2
"""Maximum size of an answer: a page of the longest comments has about 25 MiB."""
ENTRIES_PER_PAGE = 100
MAX_PAGES = 100


class MissingError(Exception):
    """The requested object does not exist, or the token has no access to it."""


class RefusedRequestError(InfrastructureError):
    """GitHub does not accept the content of a request, such as the name of something that is there already."""


@dataclass(frozen=True)
class GitHubApi:
    """Session with the API, authenticated by a token; that of another forge overrides what differs."""

    address_variable: ClassVar[str] = "GITHUB_API_URL"
    """Environment variable with the API's address, for messages."""
    accepted_type: ClassVar[str] = "application/vnd.github+json"
    """Media type of answers."""
    needed: ClassVar[str] = "the job needs permissions:"
    """Beginning of the message that names a missing permission."""
    update_method: ClassVar[str] = "PATCH"
    """HTTP method that replaces the text of a comment."""
    token: str = field(repr=False)
    url: str = API_URL
    permission: str = "pull-requests: write"
    """What a job's token needs, for messages."""
    http: Http = field(repr=False, compare=False, kw_only=True)

    @classmethod
    def open(
        cls,
        token: str,
        url: str = API_URL,
        pause: Callable[[float], None] = time.sleep,
        *,
        permission: str = "pull-requests: write",
    ) -> Self:
        """Open a session.

        Args:
            token: token of a workflow job, a user or an app.
            url: base URL of the API.
            pause: sleeps for a number of seconds before a request is repeated.
            permission: what the token of a job needs, for messages.

        Raises:
            InputError: the URL is invalid, or not encrypted.
        """
        parts = urlsplit(url)
        if not parts.netloc or parts.scheme not in ("https", "http" if is_loopback(parts.netloc) else "https"):
            raise InputError(f"{cls.address_variable}: found {url!r:.80}, expected an address such as {API_URL}")
        http = Http(
            [token], address=cls.address_variable, explain=_error_message, most_bytes=MAX_ANSWER_BYTES, pause=pause
        )
        return cls(token, url.rstrip("/"), permission, http=http)

    def request(self, method: str, path: str, body: object = None) -> Any:
        """Send a request and return the JSON answer; None if the answer is empty.

        Args:
            method: HTTP method.
            path: path below the base URL, starting with ``/``.
            body: content, sent as JSON; None for an empty body.

        Raises:
            MissingError: status 404 or 410.
            InputError: the token is refused, or lacks a permission.
            RefusedRequestError: status 422.
            InfrastructureError: GitHub is unreachable, limits the rate, or gives an unexpected answer.
        """
        content = None if body is None else json.dumps(body).encode()
        return self._parse_answer(self._send(method, self.url + path, content))

    def upload(self, url: str, content: bytes) -> None:
        """Send a file to an address that an answer has named; raises as `request`."""
        parts = urlsplit(url)
        if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.netloc)):
            raise InfrastructureError(f"{urlsplit(self.url).netloc}: names {url!r:.80} for a file, expected https")
        self._send("POST", url, content, {"Content-Type": "application/octet-stream"})

    def download(self, path: str) -> bytes:
        """Return a file; raises as `request`."""
        return self._send("GET", self.url + path, None, {"Accept": "application/octet-stream"}).body

    def _send(
        self, method: str, url: str, content: bytes | None, more: Mapping[str, str] = MappingProxyType({})
    ) -> Answer:
        """Send a request, and return its answer of success; raises as `request`."""
        headers = {
            "Accept": self.accepted_type,
            "Authorization": f"Bearer {self.token}",
            "X-GitHub-Api-Version": "2022-11-28",
            **more,
        }
        answer = self.http.send(method, url, headers, content)
        if 200 <= answer.status < 300:
            return answer
        fault = f"{urlsplit(self.url).netloc}: answered {answer.status}{self.http.quote(answer.body)}"
        if answer.status in (404, 410):
            raise MissingError(fault)
        if answer.status == 401:
            raise InputError(f"{fault}: the token is wrong or has expired")
        if answer.status == 403 and _is_rate_limit(answer):
            raise InfrastructureError(f"{fault}: the rate limit of this token is exceeded: run it again later")
        if answer.status == 403:
            raise InputError(f"{fault}: the token lacks a permission: {self.needed} {self.permission}")
        unexpected = f"{fault}: unexpected answer to {method} {urlsplit(url).path}"
        raise RefusedRequestError(unexpected) if answer.status == 422 else InfrastructureError(unexpected)

    def pages(self, path: str) -> Iterator[dict[str, Any]]:
        """Yield the entries of a paginated list, whose path ends in its query (``?...&``) or in ``?``.

        Raises:
            InfrastructureError: as `request`, or the answer is not a list.
        """
        for page in range(1, MAX_PAGES + 1):
            entries = self.list_at(f"{path}per_page={ENTRIES_PER_PAGE}&page={page}")
            yield from entries
            if len(entries) < ENTRIES_PER_PAGE:
                return

    def list_at(self, path: str) -> list[dict[str, Any]]:
        """Return a list of objects; raises as `pages`."""
        entries = self.request("GET", path)
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise InfrastructureError(f"{urlsplit(self.url).netloc}: {path}: expected a list of objects")
        return entries

    def _parse_answer(self, answer: Answer) -> Any:
        if not answer.body:
            return None
        try:
            return json.loads(answer.body)
        except (ValueError, RecursionError):
            host = urlsplit(self.url).netloc
            raise InfrastructureError(
                f"{host}: the answer is not JSON: is {self.address_variable} the address of an API?"
            ) from None


def _is_rate_limit(answer: Answer) -> bool:
    """Whether a 403 is a rate limit.

    https://docs.github.com/en/rest/using-the-rest-api/rate-limits-for-the-rest-api
    """
    return answer.headers.get("X-RateLimit-Remaining") == "0" or "Retry-After" in answer.headers


def _error_message(body: bytes) -> str:
    """Return the error message in an answer of GitHub; empty if there is none."""
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):
        return ""
    message = document.get("message") if isinstance(document, dict) else None
    return message if isinstance(message, str) else ""
