"""Comment on a pull request, identified by a hidden marker, and updated by every run."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import quote

from calibration.base.errors import InputError
from calibration.ci.github.api import GitHubApi, MissingError

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

    def _find_marked(self, key: str) -> list[Comment]:
        """Return the comments with a key, the oldest first."""
        return sorted(self._of_this_token(key), key=lambda each: each.id)

    def _of_this_token(self, key: str) -> Iterator[Comment]:
        """Yield the comments with a key that the token's user has written, because anybody can write a marker."""
        login = self._login_of_token()
        for found in self._all_comments():
            user, body, number = found.get("user"), found.get("body"), found.get("id")
            if not isinstance(user, dict) or not isinstance(body, str) or not isinstance(number, int):
                continue
            marker = _MARKER_LINE.match(body.replace("\r\n", "\n"))
            own = user.get("type") == "Bot" if login is None else user.get("login") == login
            if own and marker and marker["key"] == quote(key, safe="/"):
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
            self.api.request("PATCH", f"/repos/{self.repository}/issues/comments/{comment}", {"body": body})
        except MissingError:
            return False
        return True

    def _delete_comment(self, comment: int) -> None:
        try:
            self.api.request("DELETE", f"/repos/{self.repository}/issues/comments/{comment}")
        except MissingError:  # another run has deleted it already
            return
