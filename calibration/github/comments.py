"""One comment on a pull request, found again by a hidden marker: written anew by each run, never a second one."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import quote

from calibration.errors import InputError
from calibration.github.api import GitHubApi, MissingError

LONGEST = 65_536
"""Characters that GitHub takes in a comment."""
_UNKNOWN = "the token may not know of this pull request, or it is gone"
_MARKER = re.compile(r"<!-- calibration-ci (?P<key>[\w.~/%-]*) run (?P<run>[0-9]{1,18})\.(?P<attempt>[0-9]{1,9}) -->\n")

Kept = Literal["created", "updated", "left: a later run has written it"]


@dataclass(frozen=True)
class Marker:
    """What a comment begins with: which one it is, and which run has written it."""

    key: str
    """Which comment: the workflow, and a name in it."""
    run: tuple[int, int]
    """Number of the run, and of its attempt: a later run's are larger."""

    @property
    def text(self) -> str:
        """The line, which GitHub does not show."""
        return f"<!-- calibration-ci {quote(self.key, safe='/')} run {self.run[0]}.{self.run[1]} -->\n"


@dataclass(frozen=True)
class Comment:
    """A comment of this token's user with a marker."""

    id: int
    body: str
    run: tuple[int, int]


@dataclass(frozen=True)
class Comments:
    """The comments on one pull request."""

    api: GitHubApi
    repository: str
    """OWNER/NAME."""
    number: int

    def keep(self, marker: Marker, text: str) -> Kept:
        """Write a text into the comment with a marker's key; make the comment where there is none.

        Of two runs at once each may make one: both then keep the older comment, with the text of the later run.

        Raises:
            InputError: the token may not.
            InfrastructureError: GitHub cannot be reached, or has had too many requests.
        """
        body = (marker.text + text)[:LONGEST]
        found = self._marked(marker.key)
        if found and max(each.run for each in found) > marker.run:
            return "left: a later run has written it"
        if found and self._write(found[0].id, body):
            if len(found) > 1:
                self._settle(marker.key)
            return "updated"
        try:
            self.api.request("POST", self._list, {"body": body})
        except MissingError as error:
            raise InputError(f"{error}: {_UNKNOWN}") from None
        self._settle(marker.key)
        return "created"

    def remove(self, key: str) -> int:
        """Delete the comments with a key, and return how many there were.

        Raises:
            InputError, InfrastructureError: as `keep`.
        """
        found = self._marked(key)
        for each in found:
            self._delete(each.id)
        return len(found)

    @property
    def _list(self) -> str:
        return f"/repos/{self.repository}/issues/{self.number}/comments"

    def _marked(self, key: str) -> list[Comment]:
        """Comments with a key, the oldest first."""
        return sorted(self._of_this_token(key), key=lambda each: each.id)

    def _of_this_token(self, key: str) -> Iterator[Comment]:
        """Comments with a key that this token's user has written: anybody can write a marker."""
        login = self._login()
        for found in self._all():
            user, body, number = found.get("user"), found.get("body"), found.get("id")
            if not isinstance(user, dict) or not isinstance(body, str) or not isinstance(number, int):
                continue
            marker = _MARKER.match(body.replace("\r\n", "\n"))
            own = user.get("type") == "Bot" if login is None else user.get("login") == login
            if own and marker and marker["key"] == quote(key, safe="/"):
                yield Comment(number, body, (int(marker["run"]), int(marker["attempt"])))

    def _all(self) -> Iterator[dict[str, Any]]:
        """All comments on the pull request, anybody's."""
        try:
            yield from self.api.pages(f"{self._list}?")
        except MissingError as error:
            raise InputError(f"{error}: {_UNKNOWN}") from None

    def _login(self) -> str | None:
        """Name of the token's user; None for the token of a workflow, which may not ask: it is a bot's."""
        try:
            user = self.api.request("GET", "/user")
        except (InputError, MissingError):
            return None
        login = user.get("login") if isinstance(user, dict) else None
        return login if isinstance(login, str) else None

    def _settle(self, key: str) -> None:
        """Where there are several comments with a key, keep the oldest, with the text of the latest run."""
        found = self._marked(key)
        if len(found) < 2:
            return
        latest = max(found, key=lambda each: each.run)
        if latest.body != found[0].body:
            self._write(found[0].id, latest.body)
        for each in found[1:]:
            self._delete(each.id)

    def _write(self, comment: int, body: str) -> bool:
        """Replace the text of a comment; False where it has been deleted meanwhile."""
        try:
            self.api.request("PATCH", f"/repos/{self.repository}/issues/comments/{comment}", {"body": body})
        except MissingError:
            return False
        return True

    def _delete(self, comment: int) -> None:
        try:
            self.api.request("DELETE", f"/repos/{self.repository}/issues/comments/{comment}")
        except MissingError:  # another run was faster
            return
