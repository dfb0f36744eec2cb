"""Forgejo and Gitea Actions: GitHub's workflow commands, files and events, with fewer annotations and another API.

https://forgejo.org/docs/latest/user/actions/reference/
"""

from collections.abc import Iterable

from calibration.base import InputError
from calibration.ci.github.service import GitHub
from calibration.ci.workflow.runner import Annotation, Environment, PullRequestComments, Runner, Terminal


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
        # Here, as it imports the HTTP client, which only this command needs.
        from calibration.ci.forgejo.comments import forgejo_comments

        address = api_url or environment.get("GITHUB_API_URL")
        if not address:  # never GitHub's own
            raise InputError("GITHUB_API_URL: found none, expected https://HOST/api/v1, or it in api-url")
        return forgejo_comments(environment, token, address)


FORGEJO = Forgejo()
