"""``test-image``, and the stage test of a pipeline: all entries of ``tests`` with their repeats and retries."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import Any

import click

from calibration.addons.image_tests.results import (
    MAX_NAMED_TESTS,
    TITLE,
    ImageTestsResults,
    JudgedRun,
    Tested,
    TestsOfEntry,
    judge_run,
    report,
    results_of_entry,
)
from calibration.addons.image_tests.settings import ImageTests
from calibration.base import ExitCode, InputError, count_of
from calibration.base.records import field, flat_fields, read, record
from calibration.base.verdict import runs_show
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.job import with_secrets
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.ci.git import Repository
from calibration.ci.image.specification import Recipe
from calibration.ci.report import FILES, Report, publish, remove_results
from calibration.ci.report.junit import RepeatedFailure, repeated_failures
from calibration.ci.workflow import Runner, annotate
from calibration.ci.workflow.streams import LogDisplay, progress
from calibration.commands.parameters import given, record_options
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.running import PipelineRun

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


def run_image_tests(
    entries: Sequence[ImageTests], output: Path, repository: Path, target: ExecutionTarget, runner: Runner
) -> tuple[Report, ImageTestsResults]:
    """Run the tests of all entries, and return the report and the results.

    Args:
        entries: the tests, with their images.
        output: folder of the results, from which those of an earlier run are removed.
        repository: folder with the sources, to which the places of failures are mapped.
        target: execution target of the containers.
        runner: for progress and logs.

    Raises:
        InputError: a job is invalid, a secret is not set, or an image is missing.
        InfrastructureError: there is no engine, or a file cannot be written.
    """
    remove_results(output, FILES)
    results, last_runs = [], {}
    tracked = _tracked_files(repository)
    for tests in entries:
        attempts = _run_entry(tests, output, target, runner)
        last_runs[tests.name] = [each[-1] for each in attempts]
        found = repeated_failures([attempt.cases for attempt in run] for run in attempts)
        failures = [_at_place(failure, tracked) for failure in found]
        results.append(results_of_entry(tests, attempts, failures, output))
    whole = ImageTestsResults(tuple(results), tuple(note for each in results for note in _notes(each)))
    return report(whole, last_runs, output), whole


def _run_entry(tests: ImageTests, output: Path, target: ExecutionTarget, runner: Runner) -> list[list[JudgedRun]]:
    """Run the tests of an entry, and again those runs that fail, as often as it allows; return each run's attempts."""
    tests = replace(tests, container=with_secrets(tests.container, f"tests.{tests.name}"))
    attempts: list[list[JudgedRun]] = [[] for _ in range(tests.repeat)]
    for retry in range(tests.retries + 1):
        missing = [number for number, made in enumerate(attempts) if not made or not made[-1].passes]
        if not missing:
            break
        names = {number: _job_name(tests, number, retry) for number in missing}
        tasks = [
            Task.containers(name, tests.job(name), lambda outcome: judge_run(tests, outcome)) for name in names.values()
        ]
        with progress(runner, f"test {tests.name}", bar=False) as advance:

            def done(count: int, total: int, run: JudgedRun) -> None:
                tally = run.tally
                line = f"{tests.name}: {tally.failed} of {count_of(tally.ran, 'test')} failed ({run.seconds:.1f} s)"
                advance(count, total, line, important=not run.passes)

            found = run_tasks(tasks, output, tests.parallel, target, done=done)
        for number, name in names.items():
            attempts[number].append(found[name])
    return attempts


def _job_name(tests: ImageTests, number: int, retry: int) -> str:
    run = f"/run-{number + 1}" if tests.repeat > 1 else ""
    return f"{tests.name}{run}{f'/retry-{retry}' if retry else ''}"


def _tracked_files(folder: Path) -> list[PurePosixPath]:
    """Return the files of the repository around a folder, relative to its root; none without a repository."""
    try:
        return [PurePosixPath(path) for path in Repository.around(folder).tracked()]
    except InputError:
        return []


def _at_place(failure: RepeatedFailure, tracked: Sequence[PurePosixPath]) -> RepeatedFailure:
    """Return the failure with its file in the repository: the one that shares the longest end with its path.

    Without such a file, or with several, it has no place.
    """
    if failure.file is None:
        return failure
    parts = PurePosixPath(failure.file).parts
    same_name = [path for path in tracked if path.name == parts[-1]] if parts else []
    lengths = {path: _length_of_common_end(path.parts, parts) for path in same_name}
    longest = [path for path, length in lengths.items() if length == max(lengths.values())]
    if len(longest) != 1:
        return replace(failure, file=None, line=None)
    return replace(failure, file=str(longest[0]))


def _length_of_common_end(one: Sequence[str], other: Sequence[str]) -> int:
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(reversed(one), reversed(other), strict=False)))


def _notes(found: TestsOfEntry) -> Iterator[str]:
    for test in found.tolerated[:MAX_NAMED_TESTS]:
        yield f"{found.name}: {test.name} {test}"
    if len(found.runs) > 1:
        yield f"{found.name}: {runs_show(len(found.runs), 'test')}"


def check_tests(entries: Sequence[ImageTests], has_image: bool) -> None:
    """Refuse tests without an image.

    Raises:
        InputError: names the entry.
    """
    for tests in entries:
        if not tests.container.image and not has_image:
            raise InputError(f"tests.{tests.name}: missing image, as there is no section image that builds one")


STAGE_FOLDER = "tests"


def test_stage(run: PipelineRun) -> PipelineRun:
    """Run the tests; one that fails is a reason of the verdict.

    Raises:
        InputError: a job is invalid, a secret is not set, or an image is missing.
        InfrastructureError: there is no engine, or a file cannot be written.
    """
    entries: tuple[ImageTests, ...] = run.sections.of("tests")
    check_tests(entries, run.image is not None)
    image = run.results.image.reference if run.results.image else ""
    source = run.image.source if run.image else None
    workspace = source.workspace.path if isinstance(source, Recipe) and source.workspace else None
    folder = run.output / STAGE_FOLDER
    repository = run.config.parent if run.config else Path()
    tests = [each.with_defaults(image, workspace) for each in entries]
    report, found = run_image_tests(tests, folder, repository, run.target, run.runner)
    report.write(folder)
    annotate(run.runner, report.annotations)
    runs = [each for entry in found.tests for each in entry.runs]
    result = Tested(
        passed=sum(each.passed for each in runs),
        failed=sum(each.failed for each in runs),
        folder=STAGE_FOLDER,
        reasons=tuple(f"tests: {reason}" for reason in found.reasons),
    )
    return run.with_result("tests", result)


test_stage.__test__ = False  # type: ignore[attr-defined] # keeps pytest from collecting it
