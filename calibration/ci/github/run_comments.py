"""The comments of a workflow run on its pull request: which pull request, and which run they report."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from calibration.base.errors import InputError
from calibration.ci.github.api import API_URL, GitHubApi
from calibration.ci.github.comments import Comments, Marker
from calibration.ci.github.event import GitHubEvent


@dataclass(frozen=True)
class WorkflowRun:
    """The run that a comment reports: the current one, or the one that triggered it."""

    workflow: str
    """Name of the workflow."""
    number: tuple[int, int]
    """Numbers of the run and its attempt."""
    url: str
    """URL of the run's page."""
    commit: str | None
    """Hash of the tested commit, the head of the pull request."""


@dataclass(frozen=True)
class RunComments:
    """Comments of a run on its pull request."""

    comments: Comments
    run: WorkflowRun

    @property
    def number(self) -> int:
        """Number of the pull request."""
        return self.comments.number

    @property
    def run_url(self) -> str:
        """Address of the run's page."""
        return self.run.url

    @property
    def commit(self) -> str | None:
        """Hash of the tested commit."""
        return self.run.commit

    def keep(self, name: str, text: str) -> str:
        """Write the workflow's comment of this name; raises as `Comments.keep`."""
        return self.comments.keep(Marker(self._key_of(name), self.run.number), text)

    def remove(self, name: str) -> int:
        """Delete the workflow's comment of this name; raises as `Comments.remove`."""
        return self.comments.remove(self._key_of(name))

    def _key_of(self, name: str) -> str:
        return f"{self.run.workflow}/{name}"


def run_comments(environment: Mapping[str, str], token: str | None, api_url: str | None) -> RunComments | None:
    """Return the comments on the pull request of the event; None if it has none that is open at this commit.

    Raises:
        InputError: there is no token, or it is refused, or the run has no number.
        InfrastructureError: GitHub cannot be reached.
    """
    if token is None:
        raise InputError("token: found none, expected ${{ github.token }} (on a command line: GITHUB_TOKEN)")
    event = GitHubEvent.from_environment(environment)
    api = GitHubApi.open(token, api_url or environment.get("GITHUB_API_URL") or API_URL)
    number, run = pull_request_of(event, api), tested_run(event, environment)
    if number is None or event.repository is None:
        return None
    return RunComments(Comments(api, event.repository, number), run)


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


def tested_run(event: GitHubEvent, environment: Mapping[str, str]) -> WorkflowRun:
    """Return the run that an event reports.

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
    number = _parse_number(run, "GITHUB_RUN_ID"), _parse_number(attempt or 1, "GITHUB_RUN_ATTEMPT")
    return WorkflowRun(str(name), number, str(url), commit if isinstance(commit, str) else None)


def _parse_number(value: Any, variable: str) -> int:
    text = str(value)
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InputError(f"{variable}: found {text!r:.40}, expected the number of a run: is this a GitHub runner?")
    return int(text)
