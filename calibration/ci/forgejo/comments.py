"""Comments on pull requests of Forgejo and Gitea, whose API has GitHub's paths for them, but pages of its own."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from calibration.ci.github.api import MAX_PAGES, GitHubApi
from calibration.ci.github.comments import Comments, RunComments, run_comments

ACTIONS_USERS = ("forgejo-actions", "gitea-actions")
"""Users of a job's own token, which may not read its user."""


class ForgejoApi(GitHubApi):
    """Session with the API of Forgejo or Gitea."""

    accepted_type = "application/json"

    def pages(self, path: str) -> Iterator[dict[str, Any]]:
        """Yield the entries of a list until a page has none that is new: the list of comments ignores the page."""
        known: set[object] = set()
        for page in range(1, MAX_PAGES + 1):
            entries = [each for each in self.list_at(f"{path}limit=50&page={page}") if each.get("id") not in known]
            if not entries:
                return
            known.update(each.get("id") for each in entries)
            yield from entries


@dataclass(frozen=True)
class ForgejoComments(Comments):
    """Comments on one pull request."""

    def _is_own(self, comment: Mapping[str, Any], login: str | None) -> bool:
        user = comment.get("user")
        return isinstance(user, dict) and user.get("login") in (ACTIONS_USERS if login is None else (login,))


def forgejo_comments(environment: Mapping[str, str], token: str | None, api_url: str) -> RunComments | None:
    """Return the comments on the pull request of the event; raises as `run_comments`."""
    return run_comments(environment, token, api_url, ForgejoApi, ForgejoComments)
