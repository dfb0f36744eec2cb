"""The event of GitHub that started the workflow."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from calibration.base.errors import InputError
from calibration.base.files import read_bytes
from calibration.base.text import one_line
from calibration.ci.git.event import Event
from calibration.ci.git.repository import is_commit

MAX_EVENT_BYTES = 64 * 1024 * 1024
_DEPENDABOT_LOGIN = "dependabot[bot]"


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

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Read the event from the runner's variables and its event file.

        Raises:
            InputError: the event file cannot be read.
        """
        body: object = {}
        if path := environment.get("GITHUB_EVENT_PATH"):
            try:
                body = json.loads(read_bytes(path, MAX_EVENT_BYTES, "the event of GitHub"))
            except (ValueError, RecursionError) as error:
                raise InputError(f"{path} (GITHUB_EVENT_PATH): this is not JSON: {one_line(str(error))}") from None
        return cls(
            environment.get("GITHUB_EVENT_NAME", ""),
            environment.get("GITHUB_SHA", ""),
            environment.get("GITHUB_ACTOR", ""),
            body if isinstance(body, dict) else {},
            environment.get("GITHUB_REPOSITORY") or None,
        )

    @property
    def facts(self) -> Event:
        """The event in terms of git."""
        return Event(
            name=self.name,
            commit=self.sha,
            pull_request_commit=self._hash_at("pull_request", "head", "sha"),
            followed_commit=self._hash_at("workflow_run", "head_sha"),
            checks_out_base=self.name == "pull_request_target",
            by_stranger=self.by_stranger,
            without_secrets=self.without_secrets,
            without_comment=None if self.name == "workflow_run" else self.by_stranger,  # a workflow_run has a token
            bases=tuple(self.bases),
        )

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
