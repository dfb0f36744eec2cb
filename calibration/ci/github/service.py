"""GitHub Actions as a CI service, and GitHub's REST API.

Workflow commands in the log, files, events, and comments on pull requests:
https://docs.github.com/en/actions/reference/workflows-and-actions/workflow-commands

JSON requests, paginated lists, and error messages for users: https://docs.github.com/en/rest
"""

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self, TextIO
from urllib.parse import urlsplit

from calibration.base import InfrastructureError, InputError, brief, parse_json_of, read_bytes, visible
from calibration.base.http import Answer, Http, is_loopback
from calibration.ci.git import is_commit
from calibration.ci.workflow.runner import Annotation, Environment, Event, Level, PullRequestComments, Runner, Terminal

MAX_EVENT_BYTES = 64 * 1024 * 1024
_DEPENDABOT_LOGIN = "dependabot[bot]"
API_URL = "https://api.github.com"
MAX_ANSWER_BYTES = 64 * 1024**2
"""Maximum size of an answer: a page of the longest comments has about 25 MiB."""
ENTRIES_PER_PAGE = 100
MAX_PAGES = 100


@dataclass(frozen=True)
class GitHubEvent:
    """Event that started the workflow, with its JSON; untrusted text."""

    name: str = ""
    sha: str = ""
    """GITHUB_SHA."""
    actor: str = ""
    body: Mapping[str, Any] = field(default_factory=dict)
    repository: str | None = None
    """GITHUB_REPOSITORY, OWNER/NAME."""
    ref: str = ""
    """GITHUB_REF."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Read the event from the runner's variables and its event file.

        Raises:
            InputError: the event file cannot be read.
        """
        body: object = {}
        if path := environment.get("GITHUB_EVENT_PATH"):
            content = read_bytes(path, MAX_EVENT_BYTES, "the event of GitHub")
            body = parse_json_of(content, f"{path} (GITHUB_EVENT_PATH)", "the event of GitHub")
        return cls(
            environment.get("GITHUB_EVENT_NAME", ""),
            environment.get("GITHUB_SHA", ""),
            environment.get("GITHUB_ACTOR", ""),
            body if isinstance(body, dict) else {},
            environment.get("GITHUB_REPOSITORY") or None,
            environment.get("GITHUB_REF", ""),
        )

    @property
    def facts(self) -> Event:
        """The event in terms of git."""
        return Event(
            name=self.name,
            commit=self.sha,
            branch=self.pushed_branch,
            pull_request_commit=self._hash_at("pull_request", "head", "sha"),
            followed_commit=self._hash_at("workflow_run", "head_sha"),
            checks_out_base=self.name == "pull_request_target",
            by_stranger=self.by_stranger,
            without_secrets=self.without_secrets,
            without_comment=None if self.name == "workflow_run" else self.by_stranger,  # a workflow_run has a token
            bases=tuple(self.bases),
        )

    @property
    def pushed_branch(self) -> str | None:
        """The branch that was pushed; None for other events, for tags, and for deleted branches."""
        branch = self.ref.removeprefix("refs/heads/")
        return branch if self.name == "push" and branch not in ("", self.ref) and not self.at("deleted") else None

    def _hash_at(self, *keys: str) -> str | None:
        found = self.at(*keys)
        return found if isinstance(found, str) else None

    def at(self, *keys: str) -> Any:
        """Return a part of the event by its path of keys; None if it is missing."""
        part: Any = self.body
        for key in keys:
            part = part.get(key) if isinstance(part, dict) else None
        return part

    @property
    def by_stranger(self) -> str | None:
        """Reason why GitHub gives the run neither secrets nor a write token; None if it does.

        A pull request is from a stranger if its branch is in another repository. That the repository itself is a fork
        does not matter: a team may work in a fork of its own.
        """
        if self.actor == _DEPENDABOT_LOGIN or self.at("pull_request", "user", "login") == _DEPENDABOT_LOGIN:
            return "Dependabot started it, which is given no secrets of Actions"
        if self.name.startswith("pull_request") and self.name != "pull_request_target" and self.at("pull_request"):
            ours = self.at("pull_request", "base", "repo", "full_name") or self.repository
            if self.at("pull_request", "head", "repo", "full_name") != ours:  # missing if the fork was deleted
                return "it is a pull request from a fork, which is given no secrets"
        return None

    @property
    def without_secrets(self) -> str | None:
        """Reason why the workflow of the event has no access to the team's secrets; None if it has."""
        if self.by_stranger is None and self.at("repository", "fork") is True:
            return "it runs in a fork, which has no secrets of the original"
        return self.by_stranger

    @property
    def bases(self) -> list[str]:
        """Candidates for the commit that a change is compared with, in order of preference.

        Target of the pull request, commit before the push, main branch of the repository.
        """
        hashes = [self.at("pull_request", "base", "sha"), self.at("merge_group", "base_sha")]
        if self.name == "push":
            hashes.append(self.at("before"))
        found = [sha for sha in hashes if isinstance(sha, str) and is_commit(sha) and sha.strip("0")]
        branch = self.at("repository", "default_branch")
        return [*found, f"refs/remotes/origin/{branch}"] if isinstance(branch, str) and branch else found


WORKFLOW_FILE = Path(".github", "workflows", "calibration.yml")
_WORKFLOW_TEXT = """\
# Written by `calibration init`: calibrates what calibration.yml names, on every push and pull request.
# Jobs need Python 3.11. A container of ROS 2 Humble has 3.10: python3 -m pip install uv && uv python install 3.11
name: Calibration
on:
  push: {{branches: [main]}}
  pull_request:
permissions: {{}}
jobs:
  robot:
    uses: {suite}/.github/workflows/pipeline.yml@{version}
    permissions: {{contents: read, pull-requests: write}}
    with:
      comment: keep   # one comment on the pull request, written anew by every run; a fork's has the summary alone
"""
MAX_ANNOTATIONS_OF_LEVEL = 9
"""GitHub shows ten annotations of a level per step; the tenth counts the remaining ones."""


class GitHub(Terminal):
    """GitHub Actions, act, and what else executes workflow commands; outputs and summary are the terminal's files."""

    interactive = False
    annotates_lines = True

    def runs_here(self, environment: Environment) -> bool:
        """Return whether a runner of GitHub, or act, reads the log."""
        return environment.get("GITHUB_ACTIONS") == "true"

    def event(self, environment: Environment) -> Event:
        """Return what started the workflow."""
        return GitHubEvent.from_environment(environment).facts

    def origin(self, environment: Environment) -> tuple[str, str]:
        """Return the repository's address and the hash of the commit."""
        server, repository = environment.get("GITHUB_SERVER_URL"), environment.get("GITHUB_REPOSITORY")
        return f"{server}/{repository}" if server and repository else "", environment.get("GITHUB_SHA") or ""

    @contextmanager
    def group(self, runner: Runner, title: str) -> Iterator[None]:
        """Fold the output of the block; the runner does not support nested groups."""
        runner.log(workflow_command("group", title))
        try:
            yield
        finally:
            runner.log(workflow_command("endgroup"))

    @contextmanager
    def stop_commands(self, runner: Runner, stream: TextIO) -> Iterator[None]:
        """Disable workflow commands; the token that enables them again is random, so the output cannot contain it."""
        token = os.urandom(16).hex()
        print(workflow_command("stop-commands", token), file=stream, flush=True)
        try:
            yield
        finally:
            # On a line of its own: the output may have ended within a line.
            print(f"\n::{token}::", file=stream, flush=True)

    def annotate(self, runner: Runner, annotations: Iterable[Annotation]) -> None:
        """Print annotations as commands.

        GitHub drops annotations of a step beyond ten of a level, so the first nine are printed, and the number of the
        remaining ones.
        """
        counts = dict.fromkeys(Level, 0)
        for annotation in annotations:
            counts[annotation.level] += 1
            if counts[annotation.level] <= MAX_ANNOTATIONS_OF_LEVEL:
                runner.log(_annotation_command(runner, annotation))
        for level, count in counts.items():
            if (dropped := count - MAX_ANNOTATIONS_OF_LEVEL) > 0:
                runner.log(workflow_command(level, f"and {dropped} more: see the log and the summary"))

    def announce_error(self, runner: Runner, message: str) -> None:
        """Print it as an annotation, and set the output ``error``."""
        runner.log(workflow_command("error", message))
        super().announce_error(runner, message)

    def mask(self, runner: Runner, forms: Iterable[str]) -> None:
        """Mask each form by a command."""
        for form in forms:
            runner.log(workflow_command("add-mask", form))

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the comments on the pull request of the event; raises as `run_comments`."""
        # Here, as it imports the HTTP client, which only this command needs.
        from calibration.ci.github.comments import run_comments

        return run_comments(environment, token, api_url)


GITHUB = GitHub()


def first_workflow(suite: str, version: str) -> str:
    """Return a workflow that calls the suite's reusable workflow (OWNER/REPOSITORY) at a version."""
    return _WORKFLOW_TEXT.format(suite=suite, version=version)


def workflow_command(name: str, message: str = "", **properties: str | int | None) -> str:
    """Format a line that the runner executes (``::error file=a.csv,line=3::...``); omit properties that are None."""
    given = [f"{key}={escape_property(visible(str(value)))}" for key, value in properties.items() if value is not None]
    return f"::{name}{' ' if given else ''}{','.join(given)}::{escape_data(message)}"


def escape_data(text: str) -> str:
    """Escape the message of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def escape_property(text: str) -> str:
    """Escape the value of a property (file, line, title) of a workflow command."""
    return escape_data(text).replace(":", "%3A").replace(",", "%2C")


def _annotation_command(runner: Runner, annotation: Annotation) -> str:
    file = None if annotation.file is None else runner.relative(annotation.file)
    return workflow_command(
        annotation.level, brief(visible(annotation.message)), file=file, line=annotation.line, title=annotation.title
    )


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
