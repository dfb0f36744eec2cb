"""``coverage-upload``: tests to coverage to a verdict, and to a service that keeps it."""

import os
from typing import Any

import click

from calibration.commands.parameters import TEXT_LIST, boolean_option, number, path, text
from calibration.coverage.report import TITLE
from calibration.coverage.upload import Settings, upload
from calibration.errors import ExitCode, InputError
from calibration.programs import hide
from calibration.workflow import Runner, add_mask

TOKENS = {"project_token": "CODACY_PROJECT_TOKEN", "api_token": "CODACY_API_TOKEN"}
"""Where a token comes from on a command line."""
VARIABLES = {
    "api_url": "CODACY_API_BASE_URL",
    "provider": "CODACY_ORGANIZATION_PROVIDER",
    "organisation": "CODACY_USERNAME",
    "repository": "CODACY_PROJECT_NAME",
}
"""Codacy's own variables, for what is not given."""


def percent(value: str | float) -> float:
    """Read a number from 0 to 100; a usage error for anything else."""
    result = number(value)
    if not 0 <= result <= 100:
        raise click.BadParameter(f"{value!r} is not from 0 to 100")
    return result


@click.command(TITLE)
@click.option("--run", type=text, help="The tests: a command such as pytest -q or unittest tests, or a folder.")
@click.option("--reports", type=TEXT_LIST, help="Reports that exist, or that run writes: .coverage, Cobertura, LCOV.")
@click.option("--directory", type=path, help="Folder in the repository that the tests run in (the working directory).")
@click.option("--interpreter", type=text, help="The Python for the tests (the one that their command finds).")
@click.option("--source", type=TEXT_LIST, help="Folders and files that count, relative to directory (all in git).")
@click.option("--exclude", type=TEXT_LIST, help="Patterns of git for files that do not count (tests, setup.py).")
@click.option("--timeout", type=text, help="How long the tests may take, such as 10m (30m).")
@click.option("--goal", type=percent, help="Percent of its lines that every file is to have run; only shown (60).")
@click.option("--minimum", type=percent, help="Percent of all lines that must be run, or the verdict is fail.")
@click.option("--minimum-change", type=percent, help="Percent of the change's lines that must be run.")
@click.option("--base", type=text, help="Branch or commit that the change goes to (what the event says).")
@click.option("--badge", type=path, help="Write a badge of the coverage to this SVG file.")
@click.option("--service", type=text, help="Who is told of the coverage: codacy or none (codacy).")
@click.option("--project-token", type=text, help="Codacy's for this repository; locally by CODACY_PROJECT_TOKEN.")
@click.option("--api-token", type=text, help="Codacy's for an account; locally by CODACY_API_TOKEN.")
@click.option("--provider", type=text, help="With api-token, who hosts the repository: gh, ghe, gl, gle, bb or bbe.")
@click.option("--organisation", type=text, help="With api-token, the organisation of the repository.")
@click.option("--repository", type=text, help="With api-token, the repository's name.")
@click.option("--api-url", type=text, help="The address of Codacy's API (https://api.codacy.com).")
@click.option("--language", type=text, help="The language of all files for Codacy (by their suffix).")
@boolean_option("--partial", help="Other jobs upload coverage of this commit too; the last of them says final.")
@boolean_option("--final", help="This is the last upload for this commit; without run and reports only that is said.")
@click.option("--if-token-missing", type=text, help="fail or skip where there is no token (fail; forks are skipped).")
@click.option("--commit", type=text, help="The commit that the coverage is of (found unless given).")
@boolean_option("--dry-run", help="Send nothing, and show what would be sent.")
@click.option(
    "--output", type=path, help="Folder for results.json, junit.xml, summary.md, lcov.info, tests.xml and .log."
)
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Run tests, judge their coverage, and upload it.

    The verdict is fail when a test fails, when none ran, or when a limit is broken.
    """
    runner = Runner.from_environment(os.environ)
    return upload(settings_from(options, click_context, runner), runner)


def settings_from(options: dict[str, Any], click_context: click.Context, runner: Runner) -> Settings:
    """Make the settings of the options and of Codacy's own variables; a token is hidden at once.

    Raises:
        InputError: a token is on the command line.
    """
    for name, variable in (TOKENS | VARIABLES).items():
        options[name] = options[name] or os.environ.get(variable, "").strip() or None
    for name in TOKENS:
        if options[name]:
            add_mask(runner, options[name])
    if any(options[name] for name in TOKENS):
        hide([*TOKENS.values(), *(f"INPUT_{name.upper()}" for name in TOKENS)])  # the tests are programs of others
    for name, variable in TOKENS.items():
        if click_context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(
                f"{name.replace('_', '-')}: found on the command line, where every process reads it: "
                f"put it into the environment variable {variable}"
            )
    return Settings(**{name: value for name, value in options.items() if value not in (None, ())})
