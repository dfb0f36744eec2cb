"""``plan-matrix``, ``gather-results``, ``comment``: the first and the last jobs of the reusable workflow."""

import os
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import click

from calibration.base import ExitCode, InputError, write_atomically
from calibration.base.records import field, read, record
from calibration.ci.github.comments import comment_text
from calibration.ci.report import count_of, publish
from calibration.ci.report.report import BRIEF_FILE, Brief, read_brief
from calibration.ci.services import event_of
from calibration.ci.workflow import Annotation, Level, Runner, annotate, set_outputs, stop_commands
from calibration.ci.workflow.runner import PullRequestComments
from calibration.commands.parameters import (
    DEFAULT_ARTIFACT_NAME,
    NOISE_OPTION_OF_KEY,
    PATH_LIST,
    TEXT_LIST,
    ActionInput,
    artifact_name,
    boolean_option,
    chosen,
    given,
    masked_token,
    path,
    record_options,
    text,
)
from calibration.commands.parameters import artifact_name as artifact_name_type
from calibration.pipeline.configuration import DEFAULT_FILE, PipelineConfiguration, read_configuration
from calibration.pipeline.gathering import JOB_SUCCESS, cost_of_run, gather, parse_needs, parse_seconds, report_of_run
from calibration.pipeline.page.run_page import report_page
from calibration.pipeline.results import PAGE_FILE, clear_results
from calibration.pipeline.system import Noise, System
from calibration.pipeline.workflow_plan import (
    JobInputs,
    datasets_as_configuration,
    name_folders_by_slug,
    plan_jobs,
    plan_outputs,
    plan_text,
    read_plan,
)


def _inputs_of_other_jobs(command: Callable[..., ExitCode]) -> Callable[..., ExitCode]:
    """Declare deprecated inputs of the workflow that other jobs use: the first job tells that they are."""
    told: dict[str, tuple[str, str | None]] = {"rules": ("systems.NAME.rules", "what the file has")}
    told |= {f"analysis-{key}": (f"analysis.{key}", None) for key in ("max-new", "max-total", "max-file")}
    for name, (key, written) in told.items():
        used_later: dict[str, Any] = {"cls": ActionInput, "instead": key, "written": written, "type": TEXT_LIST}
        command = click.option(f"--{name}", **used_later, help="Used by a later job.")(command)
    return command


@click.command("plan-matrix")
@click.option("--config", type=path, help="The configuration (calibration.yml).")
@click.option(
    "--datasets",
    cls=ActionInput,
    instead="systems.NAME.dataset",
    written="the folder",
    type=PATH_LIST,
    help="Datasets, each a system; instead of config.",
)
@click.option("--systems", type=TEXT_LIST, help="Only these systems.")
@record_options(
    Noise,
    *("translation", "rotation", "seeds"),
    names=NOISE_OPTION_OF_KEY,
    helps={"seeds": "How many seeds for each pair of noises (1); always inside a job."},
)
@record_options(Noise, "seed-list", instead="noise")
@record_options(System, "evaluate", instead="systems.NAME")
@record_options(JobInputs, "noise-inside-cells", "image")
@record_options(JobInputs, "command", instead="systems.NAME.software")
@record_options(JobInputs, "tests")
@boolean_option(
    "--analyse",
    cls=ActionInput,
    instead="analysis",
    written={},
    help="Analyse the code of the repository (no).",
)
@_inputs_of_other_jobs
@record_options(JobInputs, "jobs", "may-promote", "minute-rate")
@click.option("--artifact-name", type=artifact_name, help="Prefix of the artifact names (calibration).")
@click.option("--plan-file", type=path, help="File for the plan, which gather-results reads.")
def plan_matrix_command(
    config: Path | None,
    datasets: tuple[Path, ...] | None,
    systems: tuple[str, ...] | None,
    plan_file: Path | None,
    **options: Any,
) -> ExitCode:
    """Plan the jobs of a workflow: one for each system and pair of noises, as the matrix of a GitHub job.

    Changes of strangers push no image.
    """
    runner = Runner.from_environment()
    inputs = chosen(JobInputs, options, push=event_of(os.environ).by_stranger is None)
    noise = read(Noise, given(Noise, options, names=NOISE_OPTION_OF_KEY), "options")
    if config is not None and datasets:
        raise InputError("config and datasets exclude each other: a calibration.yml, or the datasets themselves")
    configuration = datasets_as_configuration(datasets) if datasets else _read_configuration(config, inputs)
    chosen_systems = configuration.only(systems or ()) if configuration else ()
    grid = noise.grid(configuration.noise if configuration else None)
    plan = plan_jobs(configuration, chosen_systems, grid, inputs, by_path=bool(datasets))
    outputs = plan_outputs(plan)
    with stop_commands(runner):  # names of systems are untrusted
        for job, runs in plan.jobs.items():
            runner.log(f"{job}: {'yes' if runs else 'no'}")
        runner.log(f"promote: {', '.join(plan.promote) or 'no'}")
        for cell in plan.cells:
            starts = len(cell.starts(plan.seeds))
            runner.log(f"  {cell.name}{'' if starts == 1 else f': {starts} starts in one job'}")
    if plan_file is not None:
        write_atomically(plan_file, plan_text(plan))
    set_outputs(runner, outputs)
    return ExitCode.PASS


def _read_configuration(config: Path | None, inputs: JobInputs) -> PipelineConfiguration | None:
    """Return the configuration; None if only code is tested and analysed, and there is no file."""
    of_code = {"unit-tests": bool(inputs.tests), "static-analysis": inputs.analyse}
    only_code = set(inputs.jobs) <= set(of_code) if inputs.jobs else any(of_code.values())
    if config is None and only_code and not DEFAULT_FILE.exists():
        return None
    return read_configuration(config or DEFAULT_FILE)


@click.command("gather-results")
@click.option("--needs", required=True, help="Result, seconds and error of every job, as JSON.")
@click.option(
    "--folder", type=path, required=True, help="Folder with the artifacts of the jobs, each in a folder of its name."
)
@click.option("--plan-sha256", type=text, default="", help="Hash of the plan's file, an output of plan-matrix.")
@click.option(
    "--artifact-name", type=artifact_name_type, default=DEFAULT_ARTIFACT_NAME, help="Prefix of the artifact names."
)
@click.option("--output", type=path, default=Path("output"), help="Folder for the results of all (output).")
@click.option("--began", type=text, help="Start time of this job, in seconds since 1970: date +%s.")
def gather_results_command(
    needs: str, folder: Path, plan_sha256: str, artifact_name: str, output: Path, began: str | None
) -> ExitCode:
    """Merge the results of a plan's jobs; the verdict is fail if one failed, or has no results."""
    clear_results(output)
    jobs = parse_needs(needs)
    name_folders_by_slug(folder, artifact_name)
    planned = jobs.results["plan"] == JOB_SUCCESS
    plan = read_plan(folder, plan_sha256) if planned else None
    gathered = gather(jobs, plan, folder)
    code = gathered.exit_code
    promotes = bool(gathered.plan.promote) and code == ExitCode.PASS
    cost = cost_of_run(gathered.plan, jobs, folder, _seconds_since(began), promotes=promotes)
    found = report_of_run(gathered, cost, output)
    files = {**found.files, PAGE_FILE: report_page(found, gathered.results, folder)}
    outputs = {**found.outputs, "report": output / PAGE_FILE}
    publish(replace(found, files=files, outputs=outputs), Runner.from_environment(), output)
    return code


def _seconds_since(began: str | None) -> int | None:
    """Return the seconds since a time in the form of ``date +%s``; None if it is invalid or in the future."""
    if began is None or not re.fullmatch("[0-9]{1,12}", began):
        return None
    return parse_seconds(str(int(time.time()) - int(began)))


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


@click.command("comment")
@record_options(CommentSettings)
@click.pass_context
def comment_command(click_context: click.Context, /, **options: Any) -> ExitCode:
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
