"""GitLab CI as a CI service: sections in the log, a dotenv report, a code quality report, notes on merge requests.

A pipeline has one note for each name, which is kept up to date as comments of GitHub are.

https://docs.gitlab.com/ci/variables/predefined_variables/
"""

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.base import InputError, brief, one_line, read_bytes, shorten, visible, writing
from calibration.ci.git import is_commit
from calibration.ci.github.comments import Comments, RunComments, run_number
from calibration.ci.github.service import GitHubApi, MissingError
from calibration.ci.workflow.runner import (
    Annotation,
    Environment,
    Event,
    Level,
    OutputValue,
    PullRequestComments,
    Runner,
    Terminal,
    append_outputs,
)

DOTENV_VARIABLE = "CALIBRATION_DOTENV"
"""Names the file of the job's outputs, its `artifacts:reports:dotenv`."""
CODE_QUALITY_VARIABLE = "CALIBRATION_CODE_QUALITY"
"""Names the file of findings, its `artifacts:reports:codequality`."""
MAX_DOTENV_VALUE_CHARACTERS = 500
"""GitLab takes 5 KiB of a dotenv report."""
MAX_CODE_QUALITY_BYTES = 16 * 1024 * 1024
CODE_QUALITY_SEVERITY = {Level.ERROR: "major", Level.WARNING: "minor", Level.NOTICE: "info"}
_CLEAR_LINE = "\r\x1b[0K"
GITLAB_API_URL = "https://gitlab.com/api/v4"
_ZERO_WIDTH_SPACE = "\u200b"
_ACTIVE_IN_GITLAB = re.compile(r'^(?=[^\S\n]*/)|(?<=[!$~&%^])(?=[\d"])|(?<=[!$~])(?=\w)', re.MULTILINE)
"""Positions in quick actions (a line ``/merge``) and references (``!1``, ``~label``) that we deactivate."""


class GitLab(Terminal):
    """GitLab CI; messages are lines of the log. Masked variables are hidden by the runner, by no command of ours."""

    interactive = False
    annotates_lines = True
    token_variable = "GITLAB_TOKEN"  # noqa: S105 (the name of a variable)

    def runs_here(self, environment: Environment) -> bool:
        """Return whether a runner of GitLab reads the log."""
        return environment.get("GITLAB_CI") == "true"

    def runner(self, environment: Environment) -> Runner:
        """Return the runner that GitLab's variables describe."""
        project, outputs, findings = (
            Path(environment[name]) if environment.get(name) else None
            for name in ("CI_PROJECT_DIR", DOTENV_VARIABLE, CODE_QUALITY_VARIABLE)
        )
        return Runner(
            self,
            workspace=project,
            output_file=outputs,
            findings_file=findings,
            debug=environment.get("CI_DEBUG_TRACE") == "true",
            pull_request=bool(environment.get("CI_MERGE_REQUEST_IID")),
        )

    def event(self, environment: Environment) -> Event:
        """Return what started the pipeline; untrusted text.

        A merge request is from a stranger if its branch is in another project. Its pipeline runs in that project,
        without our variables, unless a member of ours has started it here: then it has them, and can write notes.
        """
        get = environment.get
        name, commit = get("CI_PIPELINE_SOURCE", ""), get("CI_COMMIT_SHA", "")
        is_merge_request = bool(get("CI_MERGE_REQUEST_IID"))
        stranger = None
        if is_merge_request and get("CI_MERGE_REQUEST_SOURCE_PROJECT_ID") != get("CI_MERGE_REQUEST_PROJECT_ID"):
            stranger = "it is a merge request from a fork, which is given no secrets"
        is_ours = get("CI_PROJECT_ID") == get("CI_MERGE_REQUEST_PROJECT_ID")
        return Event(
            name=name,
            commit=commit,
            branch=(get("CI_COMMIT_BRANCH") or None) if name == "push" else None,
            pull_request_commit=(get("CI_MERGE_REQUEST_SOURCE_BRANCH_SHA") or commit) if is_merge_request else None,
            by_stranger=stranger,
            without_secrets=stranger,
            without_comment=None if is_ours else stranger,
            bases=tuple(_bases(environment)),
        )

    def origin(self, environment: Environment) -> tuple[str, str]:
        """Return the project's address and the hash of the commit."""
        return environment.get("CI_PROJECT_URL", ""), environment.get("CI_COMMIT_SHA", "")

    @contextmanager
    def group(self, runner: Runner, title: str) -> Iterator[None]:
        """Fold the output of the block in a section, which is closed at first."""
        name = f"calibration_{time.monotonic_ns()}"
        runner.log(f"\x1b[0Ksection_start:{time.time():.0f}:{name}[collapsed=true]{_CLEAR_LINE}{visible(title)}")
        try:
            yield
        finally:
            runner.log(f"\x1b[0Ksection_end:{time.time():.0f}:{name}{_CLEAR_LINE}")

    def annotate(self, runner: Runner, annotations: Iterable[Annotation]) -> None:
        """Print lines, and add what has a file to the code quality report, if the environment names one."""
        found = list(annotations)
        super().annotate(runner, found)
        if runner.findings_file is not None:
            add_to_code_quality(runner.findings_file, runner, found)

    def set_outputs(self, runner: Runner, values: Mapping[str, OutputValue]) -> None:
        """Write variables for later jobs, ``CALIBRATION_VERDICT=pass``; a value of several lines becomes one."""
        append_outputs(runner.output_file, {_variable_of(name): _on_one_line(value) for name, value in values.items()})

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the notes on the pipeline's merge request; raises as `merge_request_notes`."""
        return merge_request_notes(environment, token, api_url)


GITLAB = GitLab()


def _bases(environment: Environment) -> Iterator[str]:
    """Yield candidates for the commit that a change is compared with: target, commit before the push, main branch."""
    for name in ("CI_MERGE_REQUEST_TARGET_BRANCH_SHA", "CI_MERGE_REQUEST_DIFF_BASE_SHA", "CI_COMMIT_BEFORE_SHA"):
        sha = environment.get(name, "")
        if is_commit(sha) and sha.strip("0"):
            yield sha
    if branch := environment.get("CI_DEFAULT_BRANCH"):
        yield f"refs/remotes/origin/{branch}"


def _variable_of(output: str) -> str:
    """Return the variable of an output; the prefix keeps it from replacing a variable of the team's."""
    return f"CALIBRATION_{output.upper().replace('-', '_')}"


def _on_one_line(value: OutputValue) -> OutputValue:
    return shorten(one_line(str(value)), MAX_DOTENV_VALUE_CHARACTERS) if isinstance(value, str | Path) else value


def add_to_code_quality(path: Path, runner: Runner, annotations: Iterable[Annotation]) -> None:
    """Add annotations that have a file to a code quality report, which is created if it is missing.

    Raises:
        InputError: the file is there, and is no code quality report.
        InfrastructureError: the file cannot be written.
    """
    entries = _read_code_quality(path) if path.exists() else []
    known = {entry.get("fingerprint") for entry in entries}
    for annotation in annotations:
        if annotation.file is None:
            continue
        entry = _code_quality_entry(annotation, runner.relative(annotation.file), known)
        known.add(entry["fingerprint"])
        entries.append(entry)
    with writing(path, "the code quality report"):
        path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


def _read_code_quality(path: Path) -> list[dict[str, Any]]:
    try:
        found = json.loads(read_bytes(path, MAX_CODE_QUALITY_BYTES, "the code quality report"))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise InputError(f"{path} ({CODE_QUALITY_VARIABLE}): found another document, expected a code quality report")
    return found


def _code_quality_entry(annotation: Annotation, file: str, known: set[Any]) -> dict[str, Any]:
    """Return an entry, whose fingerprint stays when lines move; equal ones are counted, as GitLab drops duplicates."""
    message = brief(one_line(annotation.message))
    rule = annotation.title or "calibration"
    text, count = "\0".join((rule, file, message)), 0
    while (fingerprint := hashlib.sha256(f"{text}\0{count}".encode("utf-8", "surrogateescape")).hexdigest()) in known:
        count += 1
    return {
        "description": message,
        "check_name": rule,
        "fingerprint": fingerprint,
        "severity": CODE_QUALITY_SEVERITY[annotation.level],
        "location": {"path": file, "lines": {"begin": annotation.line or 1}},
    }


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
