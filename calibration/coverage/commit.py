"""Which commit the coverage is of, and what it is compared with, from what GitHub tells about the event."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from calibration.coverage.repository import Repository, is_commit
from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.workflow.text import one_line, shorten

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


def find_commit(given: str | None, event: Event, repository: Repository) -> tuple[str, str]:
    """The commit that coverage is reported for, and where that is from.

    That of a pull request is its own last one, not the merge that GitHub makes to test it. In a
    ``pull_request_target`` it is what is checked out, which unless asked otherwise is the base.

    Raises:
        InputError: the one that is given is no hash of a commit, or there is none at all.
    """
    if given is not None:
        if not is_commit(given.lower()):
            raise InputError(f"commit: found {shorten(one_line(given))!r}, expected the 40 hexadecimal digits of one")
        return given.lower(), "as given"
    head = repository.head()
    pull_request = event.at("pull_request", "head", "sha")
    candidates = [
        (pull_request if event.name != "pull_request_target" else None, "the pull request's last"),
        (event.at("workflow_run", "head_sha"), "that of the workflow that this one follows"),
    ]
    if event.name == "pull_request_target" and head is not None:
        merged = isinstance(pull_request, str) and pull_request in repository.parents(head)
        candidates.append((pull_request if merged else head, "the one that is checked out"))
    candidates += [(event.sha, "GITHUB_SHA"), (head, "the one that is checked out")]
    for sha, source in candidates:
        if isinstance(sha, str) and is_commit(sha):
            return sha, source
    raise InputError("commit is not given, and nothing is checked out: there is no commit to report for")
