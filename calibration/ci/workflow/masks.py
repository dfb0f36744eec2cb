"""Masking of secrets in the log."""

from calibration.base.secret_forms import derived_forms
from calibration.ci.workflow.commands import workflow_command
from calibration.ci.workflow.runner import Runner


def add_mask(runner: Runner, secret: str) -> None:
    """Mask a secret in the runner's log, in every form in which it may be printed.

    Call it before any other output. Outside of GitHub it prints nothing: use :func:`redact`.
    """
    if runner.github:
        for form in derived_forms(secret):
            runner.log(workflow_command("add-mask", form))
