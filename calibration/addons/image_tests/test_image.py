"""``test-image``: the tests of the software in its image, as an action and on a command line."""

import os
from pathlib import Path
from typing import Any

import click

from calibration.addons.image_tests.results import TITLE
from calibration.addons.image_tests.running import run_image_tests
from calibration.addons.image_tests.settings import ImageTests
from calibration.base.errors import ExitCode, InputError
from calibration.base.records import field, flat_fields, read, record
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.report import publish
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from calibration.commands.parameters import given, record_options
from calibration.pipeline.configuration import read_configuration

_OWN_KEYS = (
    *("tool", "workspace", "arguments", "reports", "coverage", "coverage-files", "allow-no-tests", "repeat"),
    *("retries", "max-flake-rate", "parallel", "network", "image", "command", "user", "memory", "timeout"),
)


@record
class TestImageSettings:
    """Inputs of ``test-image`` beside those of the tests."""

    config: Path | None = field("calibration.yml with a section tests, instead of the inputs below.", default=None)
    output: Path = field("Folder for reports, logs, results.json, junit.xml and summary.md.", default=Path("output"))


@click.command(TITLE)
@record_options(TestImageSettings)
@record_options(ImageTests, *(key for key in _OWN_KEYS if key in flat_fields(ImageTests)))
def command(**options: Any) -> ExitCode:
    """Run tests in a container of an image; the verdict is fail if a test fails, crashes, hangs, or none runs."""
    settings = read(TestImageSettings, given(TestImageSettings, options), "options")
    entry = given(ImageTests, options, *_OWN_KEYS)
    return run_tests_of_image(settings, _entries(settings.config, entry), Runner.from_environment(os.environ))


def run_tests_of_image(settings: TestImageSettings, entries: tuple[ImageTests, ...], runner: Runner) -> ExitCode:
    """Run the tests, and report.

    Raises:
        InputError: an input is wrong, or an image is missing.
        InfrastructureError: there is no engine, or a file cannot be written.
    """
    target = ExecutionTarget(show=LogDisplay(runner))
    found, _ = run_image_tests(entries, settings.output, Path(), target, runner)
    return publish(found, runner, settings.output)


def _entries(config: Path | None, entry: dict[str, Any]) -> tuple[ImageTests, ...]:
    """Return the tests of a configuration, whose images are replaced by that of the options; or those of the options.

    Raises:
        InputError: there is no image, or both are given.
    """
    if config is None:
        if "image" not in entry:
            raise InputError("image: missing the image to test (or config: a calibration.yml with a section tests)")
        return (read(ImageTests, entry, "options", name="tests"),)
    if others := [key for key in entry if key != "image"]:
        raise InputError(f"{others[0]} is given beside config: write it into its section tests")
    configuration = read_configuration(config)
    entries: tuple[ImageTests, ...] | None = configuration.sections.of("tests")
    if not entries:
        raise InputError(f"{config}: found no key 'tests', which says what runs in the image")
    source = getattr(configuration.image, "source", None)
    workspace = getattr(getattr(source, "workspace", None), "path", None)
    tests = tuple(each.with_defaults(entry.get("image", ""), workspace) for each in entries)
    if missing := next((each.name for each in tests if not each.container.image), None):
        raise InputError(f"{config}: tests.{missing}: missing image: give it with image, or in the file")
    return tests
