"""The option for the password of a registry, which no command line and no message may have."""

import os

import click

from calibration.errors import InputError
from calibration.workflow import Runner, add_mask

EVERYWHERE, IN_ACTIONS = "CALIBRATION_REGISTRY_PASSWORD", "INPUT_REGISTRY_PASSWORD"
"""The variables that a password is read from, the first of them on the command line too."""
OPTION = "registry_password"

registry_password_option = click.option(
    "--registry-password",
    envvar=EVERYWHERE,
    help="Password or token of this user; on a command line by the variable CALIBRATION_REGISTRY_PASSWORD instead.",
)
"""Declares the option; `password_variable` takes its value."""


def password_variable(context: click.Context, password: str | None, runner: Runner) -> str | None:
    """Mask a password, and return the variable that holds it; None where there is no password.

    Raises:
        InputError: it stands on the command line.
    """
    if not password or not password.strip():
        return None
    add_mask(runner, password)
    if context.get_parameter_source(OPTION) is click.core.ParameterSource.COMMANDLINE:
        raise InputError(
            "registry-password: found on the command line, where every process reads it: "
            f"put it into the environment variable {EVERYWHERE}"
        )
    return EVERYWHERE if os.environ.get(EVERYWHERE) else IN_ACTIONS
