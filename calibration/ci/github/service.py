"""GitHub Actions as a CI service: workflow commands in the log, files, events, and comments on pull requests.

https://docs.github.com/en/actions/reference/workflows-and-actions/workflow-commands
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TextIO

from calibration.base import InputError, brief, one_line, read_bytes, visible
from calibration.ci.git import is_commit
from calibration.ci.workflow.runner import Annotation, Environment, Event, Level, PullRequestComments, Runner, Terminal

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
    ref: str = ""
    """GITHUB_REF."""

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
            environment.get("GITHUB_REF", ""),
        )

    @property
    def facts(self) -> Event:
        """The event in terms of git."""
        return Event(
            name=self.name,
            commit=self.sha,
            branch=self.pushed_branch,
            pull_request_commit=self._hash_at("pull_request", "head", "sha"),
            followed_commit=self._hash_at("workflow_run", "head_sha"),
            checks_out_base=self.name == "pull_request_target",
            by_stranger=self.by_stranger,
            without_secrets=self.without_secrets,
            without_comment=None if self.name == "workflow_run" else self.by_stranger,  # a workflow_run has a token
            bases=tuple(self.bases),
        )

    @property
    def pushed_branch(self) -> str | None:
        """The branch that was pushed; None for other events, for tags, and for deleted branches."""
        branch = self.ref.removeprefix("refs/heads/")
        return branch if self.name == "push" and branch not in ("", self.ref) and not self.at("deleted") else None

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


WORKFLOW_FILE = Path(".github", "workflows", "calibration.yml")
_WORKFLOW_TEXT = """\
# Written by `calibration init`: calibrates what calibration.yml names, on every push and pull request.
# Jobs need Python 3.11. A container of ROS 2 Humble has 3.10: python3 -m pip install uv && uv python install 3.11
name: Calibration
on:
  push: {{branches: [main]}}
  pull_request:
permissions: {{}}
jobs:
  robot:
    uses: {suite}/.github/workflows/pipeline.yml@{version}
    permissions: {{contents: read, pull-requests: write}}
    with:
      comment: keep   # one comment on the pull request, written anew by every run; a fork's has the summary alone
"""
MAX_ANNOTATIONS_OF_LEVEL = 9
"""GitHub shows ten annotations of a level per step; the tenth counts the remaining ones."""


class GitHub(Terminal):
    """GitHub Actions, act, and what else executes workflow commands; outputs and summary are the terminal's files."""

    interactive = False
    annotates_lines = True

    def runs_here(self, environment: Environment) -> bool:
        """Return whether a runner of GitHub, or act, reads the log."""
        return environment.get("GITHUB_ACTIONS") == "true"

    def event(self, environment: Environment) -> Event:
        """Return what started the workflow."""
        return GitHubEvent.from_environment(environment).facts

    def origin(self, environment: Environment) -> tuple[str, str]:
        """Return the repository's address and the hash of the commit."""
        server, repository = environment.get("GITHUB_SERVER_URL"), environment.get("GITHUB_REPOSITORY")
        return f"{server}/{repository}" if server and repository else "", environment.get("GITHUB_SHA") or ""

    @contextmanager
    def group(self, runner: Runner, title: str) -> Iterator[None]:
        """Fold the output of the block; the runner does not support nested groups."""
        runner.log(workflow_command("group", title))
        try:
            yield
        finally:
            runner.log(workflow_command("endgroup"))

    @contextmanager
    def stop_commands(self, runner: Runner, stream: TextIO) -> Iterator[None]:
        """Disable workflow commands; the token that enables them again is random, so the output cannot contain it."""
        token = os.urandom(16).hex()
        print(workflow_command("stop-commands", token), file=stream, flush=True)
        try:
            yield
        finally:
            # On a line of its own: the output may have ended within a line.
            print(f"\n::{token}::", file=stream, flush=True)

    def annotate(self, runner: Runner, annotations: Iterable[Annotation]) -> None:
        """Print annotations as commands.

        GitHub drops annotations of a step beyond ten of a level, so the first nine are printed, and the number of the
        remaining ones.
        """
        counts = dict.fromkeys(Level, 0)
        for annotation in annotations:
            counts[annotation.level] += 1
            if counts[annotation.level] <= MAX_ANNOTATIONS_OF_LEVEL:
                runner.log(_annotation_command(runner, annotation))
        for level, count in counts.items():
            if (dropped := count - MAX_ANNOTATIONS_OF_LEVEL) > 0:
                runner.log(workflow_command(level, f"and {dropped} more: see the log and the summary"))

    def announce_error(self, runner: Runner, message: str) -> None:
        """Print it as an annotation, and set the output ``error``."""
        runner.log(workflow_command("error", message))
        super().announce_error(runner, message)

    def mask(self, runner: Runner, forms: Iterable[str]) -> None:
        """Mask each form by a command."""
        for form in forms:
            runner.log(workflow_command("add-mask", form))

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the comments on the pull request of the event; raises as `run_comments`."""
        # Here, as it imports the HTTP client, which only this command needs.
        from calibration.ci.github.comments import run_comments

        return run_comments(environment, token, api_url)


GITHUB = GitHub()


def first_workflow(suite: str, version: str) -> str:
    """Return a workflow that calls the suite's reusable workflow (OWNER/REPOSITORY) at a version."""
    return _WORKFLOW_TEXT.format(suite=suite, version=version)


def workflow_command(name: str, message: str = "", **properties: str | int | None) -> str:
    """Format a line that the runner executes (``::error file=a.csv,line=3::...``); omit properties that are None."""
    given = [f"{key}={escape_property(visible(str(value)))}" for key, value in properties.items() if value is not None]
    return f"::{name}{' ' if given else ''}{','.join(given)}::{escape_data(message)}"


def escape_data(text: str) -> str:
    """Escape the message of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def escape_property(text: str) -> str:
    """Escape the value of a property (file, line, title) of a workflow command."""
    return escape_data(text).replace(":", "%3A").replace(",", "%2C")


def _annotation_command(runner: Runner, annotation: Annotation) -> str:
    file = None if annotation.file is None else runner.relative(annotation.file)
    return workflow_command(
        annotation.level, brief(visible(annotation.message)), file=file, line=annotation.line, title=annotation.title
    )
