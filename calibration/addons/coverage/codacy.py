"""Codacy client: coverage as Codacy's own JSON, one request for each language."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn
from urllib.parse import quote, urlsplit

from calibration.addons.coverage.formats import FileCoverage
from calibration.addons.coverage.sources import language_of
from calibration.base import InfrastructureError, InputError, count_of, shorten
from calibration.base.http import Answer, Http, is_loopback


@dataclass(frozen=True)
class Upload:
    """Coverage of one commit to be sent to a service."""

    commit: str
    files: Mapping[str, FileCoverage]
    """Coverage of each file, by path in the repository."""
    partial: bool = False
    """Whether other jobs send coverage of this commit too."""
    final: bool = False
    """Whether this is the last upload for this commit."""


@dataclass(frozen=True)
class Request:
    """An HTTP POST request with a JSON body."""

    what: str
    """Short description for the log."""
    url: str
    body: bytes
    headers: Mapping[str, str] = field(repr=False)
    """Including the token."""


API_URL = "https://api.codacy.com"
GIT_PROVIDERS = ("gh", "ghe", "gl", "gle", "bb", "bbe", "manual")
MAX_HITS = 2**31 - 1
"""Largest number of hits of a line that is sent; larger ones are cut to it."""
_NAME_IN_URL = re.compile(r"[A-Za-z0-9._~-]+")


@dataclass(frozen=True)
class Account:
    """Credentials for Codacy: a project token, or an account token with the repository's name."""

    token: str = field(repr=False)
    provider: str | None = None
    """Required with organisation and repository for an account token; unused with a project token."""
    organisation: str | None = None
    repository: str | None = None

    @property
    def header(self) -> dict[str, str]:
        """HTTP headers that authenticate the request."""
        return {"project-token" if self.provider is None else "api-token": self.token}


@dataclass(frozen=True)
class Codacy:
    """Client of Codacy's API."""

    account: Account
    api_url: str = API_URL
    language: str | None = None
    """Language of all files; None to derive it from each file's suffix."""
    http: Http | None = field(default=None, repr=False, compare=False)

    def requests(self, upload: Upload) -> list[Request]:
        """Return one report for each language, and a final request if there are several or one is asked for.

        Raises:
            InputError: none of the files is in a known language.
        """
        languages: dict[str, dict[str, FileCoverage]] = {}
        for path, coverage in sorted(upload.files.items()):
            language = self.language or language_of(path)
            if language is not None and coverage.hits:
                languages.setdefault(language.lower(), {})[path] = coverage
        partial = upload.partial or upload.final or len(languages) > 1
        found = [
            self._request_of(
                count_of(len(files), f"{language} file"),
                self._report_path(upload.commit, language) + f"?partial={'true' if partial else 'false'}",
                report_body(files),
            )
            for language, files in languages.items()
        ]
        if upload.final or (partial and not upload.partial):
            path = f"/2.0/{self._repository_path()}commit/{upload.commit}/coverageFinal"
            found.append(self._request_of("final request", path, b"{}"))
        return found

    def send(self, requests: Sequence[Request]) -> None:
        """Send all requests, even if one fails.

        Raises:
            InfrastructureError: Codacy rejected one; the first of these errors.
        """
        http = self.http or Http([self.account.token], address="the address (api-url)")
        first: InfrastructureError | None = None
        for request in requests:
            try:
                answer = http.send("POST", request.url, request.headers, request.body)
                check_answer(answer, urlsplit(request.url).netloc, http)
            except InfrastructureError as error:
                first = first or InfrastructureError(f"codacy: {error}")
        if first is not None:
            raise first

    def _request_of(self, what: str, path: str, body: bytes) -> Request:
        headers = {"Content-Type": "application/json", **self.account.header}
        return Request(what, self.api_url + path, body, headers)

    def _report_path(self, commit: str, language: str) -> str:
        place = f"commit/{commit}/coverage" if self.account.provider else f"coverage/{commit}"
        return f"/2.0/{self._repository_path()}{place}/{quote(language, safe='')}"

    def _repository_path(self) -> str:
        parts = (self.account.provider, self.account.organisation, self.account.repository)
        return "".join(f"{quote(part, safe='')}/" for part in parts if part)


def report_body(files: Mapping[str, FileCoverage]) -> bytes:
    """Return the JSON of a report: for each file, the hits of each executable line."""
    reports = [
        {
            "filename": path,
            "coverage": {str(line): min(hits, MAX_HITS) for line, hits in sorted(coverage.hits.items())},
        }
        for path, coverage in sorted(files.items())
    ]
    text = json.dumps({"fileReports": reports}, separators=(",", ":"), ensure_ascii=False)
    return text.encode("utf-8", "backslashreplace")


def check_answer(answer: Answer, host: str, http: Http) -> None:
    """Check an answer: Codacy's JSON decides on success, whatever the HTTP status.

    Raises:
        InfrastructureError: the request failed; the message names the remedy.
    """
    document = _parse_document(answer.body)
    if isinstance(document, dict) and "error" not in document and isinstance(document.get("success"), str):
        return
    answered = f"{host}: answered {answer.status}"
    if isinstance(document, dict) and "error" in document:
        _refuse_answer(answered, answer.status, http.quote(str(document["error"]).encode("utf-8", "replace")))
    if answer.status in (401, 403, 404):
        _refuse_answer(answered, answer.status, http.quote(answer.body))
    if answer.content_type == "text/html" or answer.body.lstrip()[:1] == b"<":
        raise InfrastructureError(f"{answered} with an HTML page, not from Codacy's API: check api-url and proxies")
    if document is None:
        raise InfrastructureError(f"{answered} with a body that is not JSON{http.quote(answer.body)}: check api-url")
    raise InfrastructureError(
        f"{answered} with JSON that contains neither success nor error{http.quote(answer.body)}: check api-url"
    )


def parse_api_url(text: str) -> str:
    """Parse the address of Codacy's API, such as ``https://api.codacy.com``.

    Raises:
        InputError: it is not a URL, or would send the token unencrypted.
    """
    try:
        parts = urlsplit(text.strip())
        port = parts.port
    except ValueError as error:
        raise InputError(f"api-url: found {shorten(text)!r}, which is not a URL: {error}") from None
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(f"api-url: found {shorten(text)!r}, expected an address such as {API_URL}")
    if parts.username or parts.password:
        raise InputError("api-url: it contains a user name or a password, which are not allowed")
    if parts.path.strip("/") or parts.query or parts.fragment:
        raise InputError(f"api-url: found {shorten(text)!r}, expected only scheme and host, such as {API_URL}")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    if parts.scheme == "http" and not is_loopback(host):
        raise InputError(f"api-url: found {shorten(text)!r}, expected https: the token would be sent unencrypted")
    return f"{parts.scheme}://{host}{'' if port is None else f':{port}'}"


def parse_account(
    project_token: str | None,
    api_token: str | None,
    provider: str | None,
    organisation: str | None,
    repository: str | None,
) -> Account | None:
    """Return the credentials, preferring a project token; None without a token.

    Raises:
        InputError: an account token comes without the repository, or a name or a token is malformed.
    """
    token = project_token or api_token
    if token is None:
        return None
    if not token.isascii() or not token.isprintable() or " " in token:
        name = "CODACY_PROJECT_TOKEN" if project_token else "CODACY_API_TOKEN"
        raise InputError(f"{name}: found characters that no token has (white space within it, or beyond ASCII)")
    if project_token:
        return Account(token)
    named = {"provider": provider, "organisation": organisation, "repository": repository}
    for key, value in named.items():
        if value is None:
            raise InputError(
                f"{key} is not given: CODACY_API_TOKEN is an account's and needs all of {', '.join(named)}"
            )
        if not _NAME_IN_URL.fullmatch(value) or value in (".", ".."):
            raise InputError(f"{key}: found {shorten(value)!r}, expected a name of letters, digits, dots and dashes")
    if provider not in GIT_PROVIDERS:
        raise InputError(f"provider: found {provider!r}, expected one of {', '.join(GIT_PROVIDERS)}")
    return Account(token, provider, organisation, repository)


def _parse_document(body: bytes) -> object:
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None


def _refuse_answer(answered: str, status: int, explanation: str) -> NoReturn:
    if status in (401, 403) or status == 404 or "not found" in explanation.lower():
        advice = "check the token, whether it is of this repository, and provider, organisation and repository"
    else:
        advice = "check the commit and the language, and whether Codacy knows the repository"
    raise InfrastructureError(f"{answered}{explanation}: {advice}")
