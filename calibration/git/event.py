"""What started the workflow, from what GitHub tells of the event."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.git.repository import is_commit
from calibration.workflow.text import one_line

MAX_BYTES = 64 * 1024 * 1024
_DEPENDABOT = "dependabot[bot]"


@dataclass(frozen=True)
class Event:
    """What started the workflow; empty outside of GitHub."""

    name: str = ""
    sha: str = ""
    """GITHUB_SHA."""
    actor: str = ""
    body: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Read the event.

        Raises:
            InputError: the runner's file of it cannot be read.
        """
        if environment.get("GITHUB_ACTIONS") != "true":
            return cls()
        body: object = {}
        if path := environment.get("GITHUB_EVENT_PATH"):
            try:
                body = json.loads(read_bytes(path, MAX_BYTES, "the event of GitHub"))
            except (ValueError, RecursionError) as error:
                raise InputError(f"{path} (GITHUB_EVENT_PATH): this is not JSON: {one_line(str(error))}") from None
        return cls(
            environment.get("GITHUB_EVENT_NAME", ""),
            environment.get("GITHUB_SHA", ""),
            environment.get("GITHUB_ACTOR", ""),
            body if isinstance(body, dict) else {},
        )

    def at(self, *keys: str) -> Any:
        """A part of the event; None where there is none."""
        part: Any = self.body
        for key in keys:
            part = part.get(key) if isinstance(part, dict) else None
        return part

    @property
    def without_secrets(self) -> str | None:
        """Why the event's workflow is given no secrets; None when it is."""
        if self.actor == _DEPENDABOT or self.at("pull_request", "user", "login") == _DEPENDABOT:
            return "Dependabot started it, which is given no secrets of Actions"
        if self.name.startswith("pull_request") and self.name != "pull_request_target" and self.at("pull_request"):
            head, base = (self.at("pull_request", side, "repo", "full_name") for side in ("head", "base"))
            if head != base:  # none at all when the fork was deleted
                return "it is a pull request from a fork, which is given no secrets"
        if self.at("repository", "fork") is True:
            return "it runs in a fork, which has no secrets of the original"
        return None

    @property
    def bases(self) -> list[str]:
        """Names of commits that a change may be compared with, the best first.

        Where the pull request goes, what was there before the push, else the repository's main branch.
        """
        hashes = [self.at("pull_request", "base", "sha"), self.at("merge_group", "base_sha")]
        if self.name == "push":
            hashes.append(self.at("before"))
        found = [sha for sha in hashes if isinstance(sha, str) and is_commit(sha) and sha.strip("0")]
        branch = self.at("repository", "default_branch")
        return [*found, f"refs/remotes/origin/{branch}"] if isinstance(branch, str) and branch else found
