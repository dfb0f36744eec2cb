"""Annotations: messages that GitHub shows at a file and line of the commit."""

import enum
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from calibration.base.errors import InfrastructureError, brief
from calibration.base.text import one_line, visible
from calibration.ci.workflow.commands import workflow_command
from calibration.ci.workflow.outputs import set_outputs
from calibration.ci.workflow.runner import Runner

ANNOTATION_LIMIT = 9
"""GitHub's limit of annotations of a level per step; the tenth counts the remaining ones."""
LINE_LIMIT = 1000
"""Limit of lines that are printed outside of GitHub."""


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


def annotate(runner: Runner, annotations: Iterable[Annotation]) -> None:
    """Print annotations: workflow commands on GitHub, else lines ``error: file:line: message`` on stderr.

    GitHub drops annotations of a step beyond ten of a level, so there the first nine are printed, and
    the number of the remaining ones. Print everything in the log or the summary as well, and call this
    once per step.
    """
    if not runner.github:
        lines = [_plain(annotation) for annotation in annotations]
        more = [f"and {len(lines) - LINE_LIMIT} more"] if len(lines) > LINE_LIMIT else []
        print(*lines[:LINE_LIMIT], *more, sep="\n", end="\n" if lines else "", file=runner.stderr, flush=True)
        return
    counts = dict.fromkeys(Level, 0)
    for annotation in annotations:
        counts[annotation.level] += 1
        if counts[annotation.level] <= ANNOTATION_LIMIT:
            runner.log(_command(runner, annotation))
    for level, count in counts.items():
        if count > ANNOTATION_LIMIT:
            runner.log(workflow_command(level, f"and {count - ANNOTATION_LIMIT} more: see the log and the summary"))


def report_error(runner: Runner, message: str) -> None:
    """Print the error that ends the command in one line on stderr; on GitHub as an annotation and an output too."""
    message = brief(one_line(message))
    print(f"error: {message}", file=runner.stderr, flush=True)
    if runner.github:
        runner.log(workflow_command("error", message))
        with suppress(InfrastructureError):  # the error itself has been printed
            set_outputs(runner, {"error": message})


def _command(runner: Runner, annotation: Annotation) -> str:
    file = None if annotation.file is None else runner.relative(annotation.file)
    return workflow_command(
        annotation.level, brief(visible(annotation.message)), file=file, line=annotation.line, title=annotation.title
    )


def _plain(annotation: Annotation) -> str:
    place = "" if annotation.file is None else f"{annotation.file}:"
    place += f"{annotation.line}:" if place and annotation.line is not None else ""
    return brief(one_line(f"{annotation.level}: {place}{' ' if place else ''}{annotation.message}"))
