"""``comment``: keep one comment on the pull request with the results of the last run."""

import os
from pathlib import Path
from typing import Any, Literal

import click

from calibration.base.errors import ExitCode, InputError
from calibration.base.records import field, record
from calibration.ci.git.event import Event
from calibration.ci.github.api import API_URL, GitHubApi
from calibration.ci.github.comment_text import comment_text
from calibration.ci.github.comments import Comments, Marker
from calibration.ci.github.pull_requests import pull_request_of
from calibration.ci.github.workflow_run import WorkflowRun, tested_run
from calibration.ci.report import count_of
from calibration.ci.report.brief import BRIEF_FILE, Brief, read_brief
from calibration.ci.workflow import Runner, add_mask
from calibration.ci.workflow.annotations import Annotation, Level, annotate
from calibration.ci.workflow.outputs import set_outputs
from calibration.commands.record_options import chosen, record_options

TITLE = "comment"
VARIABLE = "GITHUB_TOKEN"
NOTHING = Brief(verdict="fail", sentence="The run ended without results: see its log.")


@record
class CommentSettings:
    """Inputs of ``comment``."""

    results: Path = field("Folder with the results of run, calibrate-matrix or the workflow.", default=Path("output"))
    mode: Literal["keep", "delete"] = field("keep one comment up to date, or delete it (keep).", default="keep")
    name: str | None = field("Name, to distinguish several comments of a workflow.", default=None)
    report_url: str | None = field("Address of the report, for a link.", default=None)
    api_url: str | None = field("Address of GitHub's API (the runner's).", default=None)
    token: str | None = field(
        "Token that may write comments (permissions: pull-requests: write); locally by GITHUB_TOKEN.",
        default=None,
        repr=False,
    )


@click.command(TITLE)
@record_options(CommentSettings)
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Keep one comment on the pull request up to date, with the verdict and the changes.

    For pull requests (events pull_request and workflow_run). Outside of GitHub the comment is printed.
    """
    runner = Runner.from_environment(os.environ)
    if click_context.get_parameter_source("token") is click.core.ParameterSource.COMMANDLINE:
        raise InputError(f"token: found on the command line, where every process reads it: put it into {VARIABLE}")
    options["token"] = options["token"] or os.environ.get(VARIABLE, "").strip() or None
    if options["token"]:
        add_mask(runner, options["token"])
    return comment(chosen(CommentSettings, options), runner, Event.from_environment(os.environ))


def comment(settings: CommentSettings, runner: Runner, event: Event) -> ExitCode:
    """Write or delete the comment on an event's pull request.

    Raises:
        InputError: the results are invalid, or the token lacks a permission.
        InfrastructureError: GitHub cannot be reached.
    """
    if not event.name:
        runner.log(comment_text(_found(settings.results), settings.name or "", {}))
        return ExitCode.PASS
    if event.name != "workflow_run" and (reason := event.by_stranger):  # a workflow_run has a token
        return _without(runner, f"no comment: {reason}; a workflow of your own can write it (docs/comment.md)")
    if settings.token is None:
        raise InputError("token: found none, expected ${{ github.token }} (on a command line: GITHUB_TOKEN)")
    api = GitHubApi.open(settings.token, settings.api_url or os.environ.get("GITHUB_API_URL") or API_URL)
    number, run = pull_request_of(event, api), tested_run(event, os.environ)
    if number is None or event.repository is None:
        return _without(runner, f"no comment: the event {event.name} is about no open pull request at this commit")
    set_outputs(runner, {"number": number})
    comments = Comments(api, event.repository, number)
    key = f"{run.workflow}/{settings.name or ''}"
    if settings.mode == "delete":
        runner.log(f"pull request {number}: {count_of(comments.remove(key), 'comment')} deleted")
        return ExitCode.PASS
    text = _text(settings, run)
    runner.log(f"pull request {number}: comment {comments.keep(Marker(key, run.number), text)}")
    return ExitCode.PASS


def _text(settings: CommentSettings, run: WorkflowRun) -> str:
    """Return the text; a run without results replaces the comment too, because that of an earlier run would mislead."""
    found = _found(settings.results) if (settings.results / BRIEF_FILE).exists() else NOTHING
    links = {"run": run.url} | ({"report": settings.report_url} if settings.report_url else {})
    return comment_text(found, settings.name or "", links, run.commit)


def _found(folder: Path) -> Brief:
    return read_brief(folder / BRIEF_FILE)


def _without(runner: Runner, reason: str) -> ExitCode:
    annotate(runner, [Annotation(reason, Level.NOTICE, title=TITLE)])
    return ExitCode.PASS
