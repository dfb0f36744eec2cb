"""``comment``: keep one comment on the pull request with the results of the last run."""

import os
from pathlib import Path
from typing import Any, Literal

import click

from calibration.base import ExitCode
from calibration.base.records import field, record
from calibration.ci.github.comments import comment_text
from calibration.ci.report import count_of
from calibration.ci.report.report import BRIEF_FILE, Brief, read_brief
from calibration.ci.workflow import Annotation, Level, Runner, annotate, set_outputs
from calibration.ci.workflow.runner import PullRequestComments
from calibration.commands.parameters import chosen, masked_token, record_options

COMMAND_NAME = "comment"
NO_RESULTS = Brief(verdict="fail", sentence="The run ended without results: see its log.")


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


@click.command(COMMAND_NAME)
@record_options(CommentSettings)
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Keep one comment on the pull request up to date, with the verdict and the changes.

    For pull requests (events pull_request and workflow_run). Outside of GitHub the comment is printed.
    """
    runner = Runner.from_environment()
    options["token"] = masked_token(click_context, options["token"], runner)
    settings = chosen(CommentSettings, options)
    name = settings.name or ""
    event = runner.service.event(os.environ)
    if not event.name:
        runner.log(comment_text(read_brief(settings.results / BRIEF_FILE), name, {}))
        return ExitCode.PASS
    if reason := event.without_comment:
        return _note_absence(runner, f"{reason}; a workflow of your own can write it (docs/comment.md)")
    comments = runner.service.comments(os.environ, settings.token, settings.api_url)
    if comments is None:
        return _note_absence(runner, f"the event {event.name} is about no open pull request at this commit")
    set_outputs(runner, {"number": comments.number})
    if settings.mode == "delete":
        done = f"{count_of(comments.remove(name), 'comment')} deleted"
    else:
        done = f"comment {comments.keep(name, _comment_of_run(settings, comments))}"
    runner.log(f"pull request {comments.number}: {done}")
    return ExitCode.PASS


def _comment_of_run(settings: CommentSettings, comments: PullRequestComments) -> str:
    """Return the text; a run without results replaces the comment too, because that of an earlier run would mislead."""
    file = settings.results / BRIEF_FILE
    links = {"run": comments.run_url} | ({"report": settings.report_url} if settings.report_url else {})
    return comment_text(read_brief(file) if file.exists() else NO_RESULTS, settings.name or "", links, comments.commit)


def _note_absence(runner: Runner, reason: str) -> ExitCode:
    annotate(runner, [Annotation(f"no comment: {reason}", Level.NOTICE, title="Comment")])
    return ExitCode.PASS
