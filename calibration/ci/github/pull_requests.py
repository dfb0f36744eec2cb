"""The pull request of an event."""

from urllib.parse import quote

from calibration.ci.git.event import Event
from calibration.ci.github.api import GitHubApi


def pull_request_of(event: Event, api: GitHubApi) -> int | None:
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
    if not all(isinstance(each, str) and each for each in (owner, branch, commit)) or event.repository is None:
        return None
    head = quote(f"{owner}:{branch}", safe="")
    for found in api.pages(f"/repos/{event.repository}/pulls?state=open&head={head}&"):
        where, number = found.get("head"), found.get("number")
        if isinstance(where, dict) and where.get("sha") == commit and isinstance(number, int):
            return number
    return None
