"""Comments of a workflow run on its pull request: found by a hidden marker, updated by every run, and their Markdown.

The Markdown has no active mentions, references or links from untrusted text.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import quote

from calibration.base import InputError, escape_markdown, markdown_table
from calibration.ci.github.service import API_URL, GitHubApi, GitHubEvent, MissingError
from calibration.ci.report.report import Brief

MAX_COMMENT_CHARACTERS = 65_536
"""GitHub's limit of characters in a comment."""
_NO_ACCESS = "the token has no access to this pull request, or it does not exist"
_MARKER_LINE = re.compile(
    r"<!-- calibration-ci (?P<key>[\w.~/%-]*) run (?P<run>[0-9]{1,18})\.(?P<attempt>[0-9]{1,9}) -->\n"
)

Kept = Literal["created", "updated", "left: a later run has written it"]


@dataclass(frozen=True)
class Marker:
    """First line of a comment: identifies the comment, and the run that has written it."""

    key: str
    """Identity of the comment: workflow, and a name in it."""
    run: tuple[int, int]
    """Numbers of the run and its attempt: larger for a later run."""

    @property
    def text(self) -> str:
        """Marker as an HTML comment, which GitHub does not show."""
        return f"<!-- calibration-ci {quote(self.key, safe='/')} run {self.run[0]}.{self.run[1]} -->\n"


@dataclass(frozen=True)
class Comment:
    """A comment with a marker, by the token's user."""

    id: int
    body: str
    run: tuple[int, int]


@dataclass(frozen=True)
class Comments:
    """Comments on one pull request."""

    api: GitHubApi
    repository: str
    """OWNER/NAME."""
    number: int

    def keep(self, marker: Marker, text: str) -> Kept:
        """Update the comment with the marker's key, or create it.

        Two concurrent runs may each create one: both then keep the older comment, with the text of the later run.

        Raises:
            InputError: the token lacks a permission.
            InfrastructureError: GitHub cannot be reached, or has had too many requests.
        """
        body = (marker.text + text)[:MAX_COMMENT_CHARACTERS]
        found = self._find_marked(marker.key)
        if found and max(each.run for each in found) > marker.run:
            return "left: a later run has written it"
        if found and self._replace_text(found[0].id, body):
            if len(found) > 1:
                self._remove_duplicates(marker.key)
            return "updated"
        try:
            self.api.request("POST", self._list_path, {"body": body})
        except MissingError as error:
            raise InputError(f"{error}: {_NO_ACCESS}") from None
        self._remove_duplicates(marker.key)
        return "created"

    def remove(self, key: str) -> int:
        """Delete the comments with a key, and return their number.

        Raises:
            InputError, InfrastructureError: as `keep`.
        """
        found = self._find_marked(key)
        for each in found:
            self._delete_comment(each.id)
        return len(found)

    @property
    def _list_path(self) -> str:
        return f"/repos/{self.repository}/issues/{self.number}/comments"

    def _comment_path(self, comment: int) -> str:
        return f"/repos/{self.repository}/issues/comments/{comment}"

    def _is_own(self, comment: Mapping[str, Any], login: str | None) -> bool:
        """Whether the token's user has written a comment; without a login that is a bot."""
        user = comment.get("user")
        return isinstance(user, dict) and (user.get("type") == "Bot" if login is None else user.get("login") == login)

    def _find_marked(self, key: str) -> list[Comment]:
        """Return the comments with a key, the oldest first."""
        return sorted(self._of_this_token(key), key=lambda each: each.id)

    def _of_this_token(self, key: str) -> Iterator[Comment]:
        """Yield the comments with a key that the token's user has written, because anybody can write a marker."""
        login = self._login_of_token()
        for found in self._all_comments():
            body, number = found.get("body"), found.get("id")
            if not isinstance(body, str) or not isinstance(number, int):
                continue
            marker = _MARKER_LINE.match(body.replace("\r\n", "\n"))
            if self._is_own(found, login) and marker and marker["key"] == quote(key, safe="/"):
                yield Comment(number, body, (int(marker["run"]), int(marker["attempt"])))

    def _all_comments(self) -> Iterator[dict[str, Any]]:
        """Yield all comments on the pull request, of any author."""
        try:
            yield from self.api.pages(f"{self._list_path}?")
        except MissingError as error:
            raise InputError(f"{error}: {_NO_ACCESS}") from None

    def _login_of_token(self) -> str | None:
        """Return the login of the token's user; None for a workflow's token, which may not read it (a bot)."""
        try:
            user = self.api.request("GET", "/user")
        except (InputError, MissingError):
            return None
        login = user.get("login") if isinstance(user, dict) else None
        return login if isinstance(login, str) else None

    def _remove_duplicates(self, key: str) -> None:
        """Remove duplicates of a comment: keep the oldest, with the text of the latest run."""
        found = self._find_marked(key)
        if len(found) < 2:
            return
        latest = max(found, key=lambda each: each.run)
        if latest.body != found[0].body:
            self._replace_text(found[0].id, latest.body)
        for each in found[1:]:
            self._delete_comment(each.id)

    def _replace_text(self, comment: int, body: str) -> bool:
        """Replace the text of a comment; return False if it has been deleted meanwhile."""
        try:
            self.api.request(self.api.update_method, self._comment_path(comment), {"body": body})
        except MissingError:
            return False
        return True

    def _delete_comment(self, comment: int) -> None:
        try:
            self.api.request("DELETE", self._comment_path(comment))
        except MissingError:  # another run has deleted it already
            return


@dataclass(frozen=True)
class RunComments:
    """Comments on a pull request of the run that they report: the current one, or the one that triggered it."""

    comments: Comments
    workflow: str
    """Name of the workflow."""
    run: tuple[int, int]
    """Numbers of the run and its attempt."""
    run_url: str
    """Address of the run's page."""
    commit: str | None
    """Hash of the tested commit, the head of the pull request."""

    @property
    def number(self) -> int:
        """Number of the pull request."""
        return self.comments.number

    def keep(self, name: str, text: str) -> str:
        """Write the workflow's comment of this name; raises as `Comments.keep`."""
        return self.comments.keep(Marker(self._key_of(name), self.run), text)

    def remove(self, name: str) -> int:
        """Delete the workflow's comment of this name; raises as `Comments.remove`."""
        return self.comments.remove(self._key_of(name))

    def _key_of(self, name: str) -> str:
        return f"{self.workflow}/{name}"


def run_comments(
    environment: Mapping[str, str],
    token: str | None,
    api_url: str | None,
    api_kind: type[GitHubApi] = GitHubApi,
    comments_kind: type[Comments] = Comments,
) -> RunComments | None:
    """Return the comments on the pull request of the event; None if it has none that is open at this commit.

    A forge with events of the same form gives the kinds of its API and its comments.

    Raises:
        InputError: there is no token, or it is refused, or the run has no number.
        InfrastructureError: GitHub cannot be reached.
    """
    if token is None:
        raise InputError("token: found none, expected ${{ github.token }} (on a command line: GITHUB_TOKEN)")
    event = GitHubEvent.from_environment(environment)
    api = api_kind.open(token, api_url or environment.get("GITHUB_API_URL") or API_URL)
    number, run = pull_request_of(event, api), tested_run(event, environment)
    if number is None or event.repository is None:
        return None
    return RunComments(comments_kind(api, event.repository, number), *run)


def pull_request_of(event: GitHubEvent, api: GitHubApi) -> int | None:
    """Return the number of an event's pull request; None if there is none, or it is closed or has newer commits.

    For an event ``workflow_run`` it is found by that run's branch and commit as GitHub reports them, never by
    the artifacts of that run, which may be untrusted.

    Raises:
        InputError, InfrastructureError: as `GitHubApi.request`.
    """
    if event.name != "workflow_run":
        number = event.at("pull_request", "number")
        return number if isinstance(number, int) else None
    owner = event.at("workflow_run", "head_repository", "owner", "login")
    branch, commit = event.at("workflow_run", "head_branch"), event.at("workflow_run", "head_sha")
    if not all(isinstance(part, str) and part for part in (owner, branch, commit)) or event.repository is None:
        return None
    head = quote(f"{owner}:{branch}", safe="")
    for pull_request in api.pages(f"/repos/{event.repository}/pulls?state=open&head={head}&"):
        tip, number = pull_request.get("head"), pull_request.get("number")
        if isinstance(tip, dict) and tip.get("sha") == commit and isinstance(number, int):
            return number
    return None


def tested_run(event: GitHubEvent, environment: Mapping[str, str]) -> tuple[str, tuple[int, int], str, str | None]:
    """Return the run that an event reports: workflow, numbers, address and commit of `RunComments`.

    Raises:
        InputError: the runner does not provide the number of the run.
    """
    if event.name == "workflow_run":
        keys = ("id", "run_attempt", "name", "html_url", "head_sha")
        run, attempt, name, url, commit = (event.at("workflow_run", key) for key in keys)
    else:
        run, attempt = (environment.get(f"GITHUB_RUN_{key}") for key in ("ID", "ATTEMPT"))
        name, commit = environment.get("GITHUB_WORKFLOW"), event.at("pull_request", "head", "sha")
        url = f"{environment.get('GITHUB_SERVER_URL')}/{event.repository}/actions/runs/{run}"
    number = run_number(run, "GITHUB_RUN_ID"), run_number(attempt or 1, "GITHUB_RUN_ATTEMPT")
    return str(name), number, str(url), commit if isinstance(commit, str) else None


def run_number(value: Any, variable: str) -> int:
    """Return a number that the runner gives, such as a run's; raises `InputError` if it is none."""
    text = str(value)
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InputError(f"{variable}: found {text!r:.40}, expected a number: is this a runner of the forge?")
    return int(text)


MAX_ROWS_OF_TABLE = 40
MAX_TEXT_CHARACTERS = MAX_COMMENT_CHARACTERS - 4096
"""Characters; leaves room for the marker, and for characters that GitHub counts differently."""
_CUT_NOTE = "\n\n*Truncated: the full report is on the page of the run.*\n"
_SAFE_IN_ADDRESS = "/:?&=#%~"
"""Characters that are not escaped in an address, beside letters and digits."""
_ZERO_WIDTH_SPACE = "\u200b"
"""Zero-width space."""
_ACTIVE_POSITION = re.compile(r"(?<=@)|(?<=\\#)|(?<=:)(?=//)|(?<=[wW]{3})(?=\.)|(?<=[Gg][Hh])(?=-[0-9])")
"""Positions in mentions, references and links where `_ZERO_WIDTH_SPACE` deactivates them."""


def comment_text(brief: Brief, name: str, links: Mapping[str, str], commit: str | None = None) -> str:
    """Return the Markdown of a comment: verdict, reasons, tables, lines, links.

    Args:
        brief: results of the run, which may contain untrusted text.
        name: name of the comment for its heading, which distinguishes it from others; may be empty.
        links: trusted addresses by their title.
        commit: hash of the tested commit.
    """
    mark = {"pass": "✅", "undecided": "🟡", "fail": "❌"}[brief.verdict]
    title = f"Calibration{f' ({name})' if name else ''}: {brief.verdict}"
    parts = [f"### {mark} {_literal_text(title)}\n\n{_literal_text(brief.sentence)}\n"]
    if brief.about:
        parts.append(f"{_literal_text(brief.about)}\n")
    if brief.reasons:
        parts.append("".join(f"- {_literal_text(reason)}\n" for reason in brief.reasons))
    for table in brief.tables:
        text = _deactivate_links(markdown_table(table.columns, table.rows[:MAX_ROWS_OF_TABLE]))
        if (more := len(table.rows) - MAX_ROWS_OF_TABLE) > 0:
            text += f"\nand {more} more\n"
        parts.append(text)
    if brief.lines:
        parts.append("".join(f"- {_literal_text(line)}\n" for line in brief.lines))
    ends = [f"[{name}]({quote(address, safe=_SAFE_IN_ADDRESS)})" for name, address in links.items()]
    end = " · ".join([*ends, _literal_text(commit[:7])] if commit else ends)
    text = "\n".join(parts)
    if len(text) > MAX_TEXT_CHARACTERS:
        text = text[: text.rfind("\n", 0, MAX_TEXT_CHARACTERS)] + _CUT_NOTE
    return f"{text}\n{end}\n"


def _literal_text(text: str) -> str:
    """Escape a text to one line of Markdown that shows it literally; indented, it would be a block of code."""
    return _deactivate_links(escape_markdown(text).strip())


def _deactivate_links(markdown: str) -> str:
    """Deactivate mentions, references and automatic links in Markdown."""
    return _ACTIVE_POSITION.sub(_ZERO_WIDTH_SPACE, markdown)
