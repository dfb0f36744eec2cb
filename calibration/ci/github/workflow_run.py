"""The workflow run that a comment reports: the current run, or the one that triggered it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calibration.base.errors import InputError
from calibration.ci.git.event import Event


@dataclass(frozen=True)
class WorkflowRun:
    """A run of a workflow."""

    workflow: str
    """Name of the workflow."""
    number: tuple[int, int]
    """Numbers of the run and its attempt."""
    url: str
    """URL of the run's page."""
    commit: str | None
    """Hash of the tested commit, the head of the pull request."""


def tested_run(event: Event, environment: Mapping[str, str]) -> WorkflowRun:
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
    number = _number(run, "GITHUB_RUN_ID"), _number(attempt or 1, "GITHUB_RUN_ATTEMPT")
    return WorkflowRun(str(name), number, str(url), commit if isinstance(commit, str) else None)


def _number(value: Any, name: str) -> int:
    text = str(value)
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InputError(f"{name}: found {text!r:.40}, expected the number of a run: is this a GitHub runner?")
    return int(text)
