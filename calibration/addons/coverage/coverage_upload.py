"""``coverage-upload``: run tests, check their coverage, and upload it to a service."""

import os
from typing import Any

import click

from calibration.addons.coverage.report import TITLE
from calibration.addons.coverage.upload import Settings, upload
from calibration.base.errors import ExitCode, InputError
from calibration.base.programs import hide
from calibration.ci.workflow import Runner, add_mask
from calibration.commands.record_options import chosen, record_options

TOKEN_VARIABLES = {"project_token": "CODACY_PROJECT_TOKEN", "api_token": "CODACY_API_TOKEN"}
"""Environment variables of tokens."""
CODACY_VARIABLES = {
    "api_url": "CODACY_API_BASE_URL",
    "provider": "CODACY_ORGANIZATION_PROVIDER",
    "organisation": "CODACY_USERNAME",
    "repository": "CODACY_PROJECT_NAME",
}
"""Codacy's own variables, as defaults of options."""


@click.command(TITLE)
@record_options(Settings)
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Run tests, check their coverage, and upload it.

    The verdict is fail if a test fails, no test runs, or a limit is broken.
    """
    runner = Runner.from_environment(os.environ)
    return upload(settings_from(options, click_context, runner), runner)


def settings_from(options: dict[str, Any], click_context: click.Context, runner: Runner) -> Settings:
    """Create the settings from the options and Codacy's variables; tokens are masked immediately.

    Raises:
        InputError: a token is on the command line.
    """
    for name, variable in (TOKEN_VARIABLES | CODACY_VARIABLES).items():
        options[name] = options[name] or os.environ.get(variable, "").strip() or None
    for name in TOKEN_VARIABLES:
        if options[name]:
            add_mask(runner, options[name])
    if any(options[name] for name in TOKEN_VARIABLES):
        hide(
            [*TOKEN_VARIABLES.values(), *(f"INPUT_{name.upper()}" for name in TOKEN_VARIABLES)]
        )  # the tests are untrusted programs
    for name, variable in TOKEN_VARIABLES.items():
        if click_context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(
                f"{name.replace('_', '-')}: found on the command line, where every process reads it: "
                f"put it into the environment variable {variable}"
            )
    return chosen(Settings, options)
