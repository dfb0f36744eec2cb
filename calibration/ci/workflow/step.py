"""What a step tells its CI service: groups of its log, annotations, secrets, outputs and a summary."""

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from typing import TextIO

from calibration.base.errors import brief
from calibration.base.redaction import derived_forms
from calibration.base.text import one_line
from calibration.ci.workflow.annotation import Annotation
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.step_files import OutputValue


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

    Call it before any other output. On a terminal it does nothing: use `calibration.base.redaction.redact`.
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
