"""The runner of a step, and the interface of the CI service that runs it: a plain terminal, if there is none.

Outputs and summary are handed over by files in GitHub's form.
"""

import enum
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TextIO, TypeAlias

from calibration.base import InfrastructureError, InputError, brief, one_line, writing
from calibration.base.text import derived_forms


class Level(enum.StrEnum):
    """Severity of an annotation."""

    ERROR = "error"
    WARNING = "warning"
    NOTICE = "notice"


@dataclass(frozen=True)
class Annotation:
    """Message of an annotation, with its file and line if it has them."""

    message: str
    level: Level = Level.ERROR
    file: str | Path | None = None
    line: int | None = None
    """Line number, the first is 1."""
    title: str | None = None


OutputValue: TypeAlias = str | Path | bool | int | float | Sequence[object] | Mapping[str, object]
"""Booleans are written as true and false, lists and mappings as JSON on one line."""
MAX_SUMMARY_BYTES = 1024 * 1024
"""GitHub's limit of the summary of a step; a longer one is dropped completely."""

_OUTPUT_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_CUT_NOTE = b"\n\n*The summary was cut here: GitHub takes 1 MiB. Everything is in the log.*\n"


def append_outputs(path: Path | None, values: Mapping[str, OutputValue]) -> None:
    """Append outputs of the step to a file; check them only, if there is none.

    Raises:
        ValueError: GitHub rejects a name, or a number is not finite.
        InfrastructureError: the file cannot be written.
    """
    lines = "".join(_format_assignment(name, _output_text(value)) for name, value in values.items())
    if path is None:
        return
    with (
        writing(path, "the step's outputs"),
        path.open("a", encoding="utf-8", errors="backslashreplace", newline="") as file,
    ):
        file.write(lines)


def append_summary(path: Path | None, markdown: str) -> None:
    """Append Markdown to the step's summary, if there is a file for it; beyond the limit it is cut with a remark.

    Raises:
        InfrastructureError: the file cannot be written.
    """
    if path is None:
        return
    with writing(path, "the step's summary"), path.open("ab") as file:
        text = (markdown.rstrip("\n") + "\n").encode("utf-8", "replace")
        file.write(_cut_to_bytes(text, MAX_SUMMARY_BYTES - file.tell()))


def _output_text(value: OutputValue) -> str:
    if isinstance(value, str | Path):
        return str(value)
    return json.dumps(value, allow_nan=False)


def _format_assignment(name: str, value: str) -> str:
    if not _OUTPUT_NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of an output")
    if "\n" not in value and "\r" not in value:
        return f"{name}={value}\n"
    # A random end, which the value cannot contain: otherwise untrusted text could set another output.
    delimiter = f"end-{os.urandom(16).hex()}"
    return f"{name}<<{delimiter}\n{value}\n{delimiter}\n"


def _cut_to_bytes(text: bytes, room: int) -> bytes:
    """Cut a text at the end of a line, so that it fits with a note."""
    if len(text) <= room:
        return text
    if room < len(_CUT_NOTE):
        return b""
    kept = text[: room - len(_CUT_NOTE)]
    kept = kept[: kept.rfind(b"\n")] if b"\n" in kept else kept.decode("utf-8", "ignore").encode()
    return kept + _CUT_NOTE


@dataclass(frozen=True)
class Event:
    """What started the run, as its CI service tells; nothing is known on a terminal."""

    name: str = ""
    """The service's own name: push, pull_request; empty on a terminal."""
    commit: str = ""
    """Hash of the commit that the service runs on; of a pull request it may be a merge made for testing."""
    branch: str | None = None
    """The branch that was pushed; None if something else started the run."""
    pull_request_commit: str | None = None
    """Hash of the last commit of the pull request's branch."""
    followed_commit: str | None = None
    """Hash of the commit of the earlier run that this one follows."""
    checks_out_base: bool = False
    """Whether the checkout of a pull request is its base, unless the workflow asks for another commit."""
    by_stranger: str | None = None
    """Reason why the run has neither secrets nor a write token; None if it has."""
    without_secrets: str | None = None
    """Reason why the run has no access to the team's secrets; None if it has."""
    without_comment: str | None = None
    """Reason why the run cannot write comments; None if it can."""
    bases: tuple[str, ...] = ()
    """Commits or branches that a change may be compared with, in order of preference."""


MAX_PLAIN_ANNOTATIONS = 1000
"""Maximum number of annotations that are printed as plain lines."""

Environment: TypeAlias = Mapping[str, str]
"""Environment variables of the step."""


class PullRequestComments(Protocol):
    """The comments of a run on its pull request."""

    @property
    def number(self) -> int:
        """Number of the pull request."""

    @property
    def run_url(self) -> str:
        """Address of the run's page."""

    @property
    def commit(self) -> str | None:
        """Hash of the tested commit."""

    def keep(self, name: str, text: str) -> str:
        """Write the comment of this name, or replace its text; return what was done, for the log."""

    def remove(self, name: str) -> int:
        """Delete the comment of this name; return how many there were."""


class Terminal:
    """No CI service, and the interface of one: how a step talks to it. It has no state; streams are the runner's.

    A service subclasses it and overrides what differs; a line in `calibration.ci.services.SERVICES` makes it known.
    Here are plain lines and no commands; outputs and summary are written if the environment names a file.
    """

    interactive = True
    """Whether somebody may watch a terminal: progress bars, and lines of concurrent programs side by side."""
    annotates_lines = False
    """Whether annotations are shown at a line of a file, and may have several lines themselves."""
    token_variable = "GITHUB_TOKEN"  # noqa: S105 (the name of a variable)
    """Environment variable with a token that may write comments."""

    def runs_here(self, environment: Environment) -> bool:
        """Return whether this service runs the step: the terminal is what remains."""
        return True

    def runner(self, environment: Environment) -> "Runner":
        """Return the runner that the environment describes; an empty variable counts as unset.

        GitHub's variables are read, by which a caller without a service can have the files too.
        """

        def path(name: str) -> Path | None:
            return Path(environment[name]) if environment.get(name) else None

        return Runner(
            self,
            workspace=path("GITHUB_WORKSPACE"),
            output_file=path("GITHUB_OUTPUT"),
            summary_file=path("GITHUB_STEP_SUMMARY"),
            debug=environment.get("RUNNER_DEBUG") == "1",
            pull_request=environment.get("GITHUB_EVENT_NAME", "").startswith("pull_request"),
        )

    def event(self, environment: Environment) -> Event:
        """Return what started the run; raises `InputError` if the service's description of it is unreadable."""
        return Event()

    def origin(self, environment: Environment) -> tuple[str, str]:
        """Return the repository's address and the hash of the commit; empty if they are not known."""
        return "", ""

    @contextmanager
    def group(self, runner: "Runner", title: str) -> Iterator[None]:
        """Fold the output of the block under a title of one line; a terminal prints the title only."""
        runner.log(title)
        yield

    def stop_commands(self, runner: "Runner", stream: TextIO) -> AbstractContextManager[None]:
        """Let no line of the block's output be executed as a command of the service; a terminal has none."""
        return nullcontext()

    def annotate(self, runner: "Runner", annotations: Iterable[Annotation]) -> None:
        """Show messages at files and lines of the commit: lines ``error: file:line: message`` on stderr."""
        lines = [_plain_line(annotation) for annotation in annotations]
        if (dropped := len(lines) - MAX_PLAIN_ANNOTATIONS) > 0:
            lines[MAX_PLAIN_ANNOTATIONS:] = [f"and {dropped} more"]
        print("".join(f"{line}\n" for line in lines), end="", file=runner.stderr, flush=True)

    def announce_error(self, runner: "Runner", message: str) -> None:
        """Announce the error that ends the command, which stands on stderr already: by the output ``error``."""
        with suppress(InfrastructureError):  # the error itself has been printed
            self.set_outputs(runner, {"error": message})

    def mask(self, runner: "Runner", forms: Iterable[str]) -> None:
        """Hide every form of a secret in the log from now on.

        A terminal hides nothing, so secrets are redacted before they are printed.
        """

    def set_outputs(self, runner: "Runner", values: Mapping[str, OutputValue]) -> None:
        """Set outputs of the step, for later steps: ``NAME=VALUE`` in the runner's file, if it has one."""
        append_outputs(runner.output_file, values)

    def add_summary(self, runner: "Runner", markdown: str) -> None:
        """Add Markdown to the page of the run: to the runner's file, if it has one."""
        append_summary(runner.summary_file, markdown)

    def comments(self, environment: Environment, token: str | None, api_url: str | None) -> PullRequestComments | None:
        """Return the comments on the pull request of the run; None if it has none that is open at this commit.

        Raises:
            InputError: the service has no comments, or we do not know them.
        """
        raise InputError(
            "comment: this CI service has no comments that we can write, expected GitHub, GitLab or Forgejo"
        )


def _plain_line(annotation: Annotation) -> str:
    place = "" if annotation.file is None else f"{annotation.file}:"
    place += f"{annotation.line}:" if place and annotation.line is not None else ""
    return brief(one_line(f"{annotation.level}: {place}{' ' if place else ''}{annotation.message}"))


@dataclass(frozen=True)
class Runner:
    """Runner of a step: its CI service, what its environment variables name, and its output streams."""

    service: Terminal = field(default_factory=lambda: TERMINAL)  # which is made below, as its methods take a runner
    workspace: Path | None = None
    """The checkout; annotations name files relative to it."""
    output_file: Path | None = None
    """File for the step's outputs; None without a runner."""
    summary_file: Path | None = None
    """File for the step's Markdown summary; None without a runner."""
    debug: bool = False
    """Whether debug logging is enabled on the runner."""
    pull_request: bool = False
    """Whether the run is for an unmerged pull request."""
    findings_file: Path | None = None
    """File for annotations as findings, where the service reads one."""
    stdout: TextIO = field(default_factory=lambda: sys.stdout, repr=False, compare=False)
    """Stream of the log and the service's commands."""
    stderr: TextIO = field(default_factory=lambda: sys.stderr, repr=False, compare=False)
    """Stream of errors, one line each."""

    @classmethod
    def from_environment(cls, environment: Environment | None = None) -> "Runner":
        """Return the runner of the service that runs this step, by default of this process."""
        from calibration.ci.services import service_of  # here, as the services import this module

        variables = os.environ if environment is None else environment
        return service_of(variables).runner(variables)

    @property
    def on_terminal(self) -> bool:
        """Whether somebody watches the log on a terminal."""
        return self.service.interactive and self.stdout.isatty()

    def log(self, text: str = "") -> None:
        """Print a line to the log immediately.

        Untrusted text may contain commands of the service: print it inside
        :func:`calibration.ci.workflow.stop_commands`.
        """
        print(text, file=self.stdout, flush=True)

    def relative(self, path: str | Path) -> str:
        """Return the path of a file for an annotation: relative to the workspace if it is inside, with ``/``."""
        if self.workspace is not None:
            resolved = Path(os.path.realpath(path))
            workspace = Path(os.path.realpath(self.workspace))
            if resolved.is_relative_to(workspace):
                return resolved.relative_to(workspace).as_posix()
        return str(path)


TERMINAL: Terminal = Terminal()


def group(runner: Runner, title: str) -> AbstractContextManager[None]:
    """Fold the output of the block under a title; a terminal shows the title only.

    GitHub does not support nested groups. Print the verdict outside.
    """
    return runner.service.group(runner, one_line(title))


def stop_commands(runner: Runner, stream: TextIO | None = None) -> AbstractContextManager[None]:
    """Disable the service's commands in the output of the block, for output of other programs.

    ``stream`` is the stream of the output, by default stdout.
    """
    return runner.service.stop_commands(runner, stream or runner.stdout)


def annotate(runner: Runner, annotations: Iterable[Annotation]) -> None:
    """Print annotations, which the service shows at their files; a terminal has lines ``error: file:line: message``.

    A service may show only the first ones: print everything in the log or the summary as well, and call this
    once per step.
    """
    runner.service.annotate(runner, annotations)


def report_error(runner: Runner, message: str) -> None:
    """Print the error that ends the command in one line on stderr, and announce it to the service."""
    message = brief(one_line(message))
    print(f"error: {message}", file=runner.stderr, flush=True)
    runner.service.announce_error(runner, message)


def add_mask(runner: Runner, secret: str) -> None:
    """Mask a secret in the service's log, in every form in which it may be printed.

    Call it before any other output. On a terminal it does nothing: use `calibration.base.text.redact`.
    """
    runner.service.mask(runner, derived_forms(secret))


def set_outputs(runner: Runner, values: Mapping[str, OutputValue]) -> None:
    """Set outputs of the step; does nothing if the runner has no place for them.

    Raises:
        ValueError: the service rejects a name, or a number is not finite.
        InfrastructureError: they cannot be written.
    """
    runner.service.set_outputs(runner, values)


def add_summary(runner: Runner, markdown: str) -> None:
    """Append Markdown to the step's summary; does nothing if the runner has no place for it.

    Raises:
        InfrastructureError: it cannot be written.
    """
    runner.service.add_summary(runner, markdown)
