"""Forgejo and Gitea Actions: GitHub's workflow commands, files and events, with fewer annotations and another API.

Comments on pull requests have GitHub's paths, but pages of their own.

https://forgejo.org/docs/latest/user/actions/reference/
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from calibration.base import InputError
from calibration.ci.github.comments import Comments, RunComments, run_comments
from calibration.ci.github.service import MAX_PAGES, GitHub, GitHubApi
from calibration.ci.workflow.runner import Annotation, Environment, PullRequestComments, Runner, Terminal

ACTIONS_USERS = ("forgejo-actions", "gitea-actions")
"""Users of a job's own token, which may not read its user."""


class Forgejo(GitHub):
    """Forgejo, Gitea and their runners: annotations are lines of the log, as there is no other place for them."""

    annotates_lines = False

    def runs_here(self, environment: Environment) -> bool:
        """Return whether a runner of Forgejo or Gitea reads the log; it sets GITHUB_ACTIONS too."""
        return "true" in (environment.get("FORGEJO_ACTIONS"), environment.get("GITEA_ACTIONS"))

    def annotate(self, runner: Runner, annotations: Iterable[Annotation]) -> None:
        """Print all of them as lines."""
        Terminal.annotate(self, runner, annotations)

    def announce_error(self, runner: Runner, message: str) -> None:
        """Set the output ``error``."""
        Terminal.announce_error(self, runner, message)

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the comments on the pull request of the event; raises as `run_comments`, and without an address."""
        address = api_url or environment.get("GITHUB_API_URL")
        if not address:  # never GitHub's own
            raise InputError("GITHUB_API_URL: found none, expected https://HOST/api/v1, or it in api-url")
        return forgejo_comments(environment, token, address)


FORGEJO = Forgejo()


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
