"""GitHub Actions as a CI service: workflow commands in the log, files, events, and comments on pull requests.

https://docs.github.com/en/actions/reference/workflows-and-actions/workflow-commands
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from calibration.base.errors import InfrastructureError, brief
from calibration.base.text import visible
from calibration.ci.git.event import Event
from calibration.ci.github.event import GitHubEvent
from calibration.ci.workflow.annotation import Annotation, Level
from calibration.ci.workflow.runner import Environment, PullRequestComments, Runner, Terminal

WORKFLOW_FILE = Path(".github", "workflows", "calibration.yml")
_WORKFLOW_TEXT = """\
# Written by `calibration init`: calibrates what calibration.yml names, on every push and pull request.
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
        with suppress(InfrastructureError):  # the error itself has been printed
            self.set_outputs(runner, {"error": message})

    def mask(self, runner: Runner, forms: Iterable[str]) -> None:
        """Mask each form by a command."""
        for form in forms:
            runner.log(workflow_command("add-mask", form))

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the comments on the pull request of the event; raises as `run_comments`."""
        # Here, as it imports the HTTP client, which only this command needs.
        from calibration.ci.github.run_comments import run_comments

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
