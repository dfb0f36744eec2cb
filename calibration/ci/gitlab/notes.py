"""Notes of a pipeline on its merge request, one for each name, kept up to date as comments of GitHub are."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calibration.base import InputError
from calibration.ci.github.api import GitHubApi, MissingError
from calibration.ci.github.comments import Comments, RunComments, run_number

GITLAB_API_URL = "https://gitlab.com/api/v4"
_ZERO_WIDTH_SPACE = "\u200b"
_ACTIVE_IN_GITLAB = re.compile(r'^(?=[^\S\n]*/)|(?<=[!$~&%^])(?=[\d"])|(?<=[!$~])(?=\w)', re.MULTILINE)
"""Positions in quick actions (a line ``/merge``) and references (``!1``, ``~label``) that we deactivate."""


class GitLabApi(GitHubApi):
    """Session with GitLab's API, whose lists, answers and tokens have the same form."""

    address_variable = "CI_API_V4_URL"
    accepted_type = "application/json"
    needed = "it needs the scope api and the role Developer, on"
    update_method = "PUT"


@dataclass(frozen=True)
class Notes(Comments):
    """Notes on one merge request of a project, whose number is `repository`."""

    @property
    def _list_path(self) -> str:
        return f"/projects/{self.repository}/merge_requests/{self.number}/notes"

    def _comment_path(self, comment: int) -> str:
        return f"{self._list_path}/{comment}"

    def _is_own(self, comment: Mapping[str, Any], login: str | None) -> bool:
        author = comment.get("author")
        return isinstance(author, dict) and login is not None and author.get("username") == login

    def _login_of_token(self) -> str | None:
        try:
            user = self.api.request("GET", "/user")
        except MissingError as error:
            raise InputError(f"{error}: CI_API_V4_URL or api-url is no address of GitLab's API") from None
        login = user.get("username") if isinstance(user, dict) else None
        return login if isinstance(login, str) else None


@dataclass(frozen=True)
class RunNotes(RunComments):
    """Notes of a pipeline on its merge request."""

    def keep(self, name: str, text: str) -> str:
        """Write the job's note of this name, in which nothing but its last line of links is active."""
        body, end, links = text.rstrip("\n").rpartition("\n")
        return super().keep(name, f"{_ACTIVE_IN_GITLAB.sub(_ZERO_WIDTH_SPACE, body)}{end}{links}\n")


def merge_request_notes(environment: Mapping[str, str], token: str | None, api_url: str | None) -> RunNotes | None:
    """Return the notes on the pipeline's merge request; None if it has none.

    Raises:
        InputError: there is no token, or the pipeline has no number.
    """
    project, number = environment.get("CI_MERGE_REQUEST_PROJECT_ID"), environment.get("CI_MERGE_REQUEST_IID")
    if not project or not number:
        return None
    if token is None:
        raise InputError("token: found none, expected a project access token (scope api) as GITLAB_TOKEN")
    api = GitLabApi.open(token, api_url or environment.get("CI_API_V4_URL") or GITLAB_API_URL, permission="the project")
    return RunNotes(
        Notes(api, str(run_number(project, "CI_MERGE_REQUEST_PROJECT_ID")), run_number(number, "CI_MERGE_REQUEST_IID")),
        environment.get("CI_JOB_NAME", ""),
        (run_number(environment.get("CI_PIPELINE_ID"), "CI_PIPELINE_ID"), 1),  # a job that is retried replaces its note
        environment.get("CI_PIPELINE_URL", ""),
        environment.get("CI_MERGE_REQUEST_SOURCE_BRANCH_SHA") or environment.get("CI_COMMIT_SHA"),
    )
