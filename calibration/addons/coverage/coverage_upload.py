"""``coverage-upload``: run tests, check their coverage, and upload it to a service."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import click

from calibration.addons.coverage.codacy import API_URL, Account, Codacy, Request, Upload, parse_account, parse_api_url
from calibration.addons.coverage.coverage_py import plain, team_settings
from calibration.addons.coverage.pseudo_tested import LOG_FILE, OVER_BUDGET, PseudoTestedResults, find_pseudo_tested
from calibration.addons.coverage.reading import Found, read_reports
from calibration.addons.coverage.report import LCOV_FILE, TITLE, badge, report, what_is_left_out
from calibration.addons.coverage.results import (
    CoverageLimit,
    CoverageResults,
    PseudoTestedLimit,
    State,
    Uploaded,
    coverage_of_change,
)
from calibration.addons.coverage.sources import (
    PYTHON_LANGUAGE,
    PythonFunction,
    Sources,
    find_commit,
    find_sources,
    functions_of,
    language_of,
)
from calibration.addons.coverage.tests import (
    CommandOfTests,
    Tests,
    measured_environment,
    measurement,
    parse_command,
    run_tests,
)
from calibration.base import ExitCode, InfrastructureError, InputError, one_line, temporary_folder, write_atomically
from calibration.base.files import matching
from calibration.base.process import hide
from calibration.base.records import at_least, between, field, record
from calibration.ci.execution.job import parse_seconds
from calibration.ci.git import Repository, changed_lines, files_without_lines, find_base
from calibration.ci.report import FILES, publish, remove_results
from calibration.ci.report.report import BRIEF_FILE
from calibration.ci.services import event_of
from calibration.ci.workflow import Runner, set_outputs
from calibration.ci.workflow.runner import Event
from calibration.commands.parameters import chosen, masked_secret, record_options

TOKEN_VARIABLES = {"project_token": "CODACY_PROJECT_TOKEN", "api_token": "CODACY_API_TOKEN"}
"""Environment variables of tokens."""
CODACY_VARIABLES = {
    "api_url": "CODACY_API_BASE_URL",
    "provider": "CODACY_ORGANIZATION_PROVIDER",
    "organisation": "CODACY_USERNAME",
    "repository": "CODACY_PROJECT_NAME",
}
"""Codacy's own variables, as defaults of options."""
FOR_SERVICE = ("project_token", "api_token", "partial", "final", "dry_run")
"""Inputs that have an effect only with a service."""
CLOCK_TOLERANCE = 2.0
"""Tolerance for file times, in seconds."""


Percent = Annotated[float, between(0, 100)]


@record
class CoverageSettings:
    """Inputs of ``coverage-upload``."""

    tests: str | None = field(
        "Test command such as pytest -q or unittest tests, or a folder of tests.", default=None, formerly="run"
    )
    reports: tuple[str, ...] = field(
        "Report files, existing or written by tests: .coverage, Cobertura, LCOV.", default=()
    )
    directory: Path = field(
        "Working directory of the tests, in the repository (the current directory).", default=Path()
    )
    interpreter: str | None = field("Python interpreter of the tests (the first on the PATH).", default=None)
    source: tuple[str, ...] = field("Folders and files that count, relative to directory (all in git).", default=())
    exclude: tuple[str, ...] | None = field(
        "Patterns of git for files that do not count (tests, setup.py).", default=None
    )
    timeout: str = field("How long the tests may take, such as 10m (30m).", default="30m")
    goal: Percent = field("Percent of its lines that every file is to have run; only shown (60).", default=60.0)
    minimum: Percent | None = field("Percent of all lines that must be run, or the verdict is fail.", default=None)
    minimum_change: Percent | None = field("Percent of the change's lines that must be run.", default=None)
    minimum_functions: Percent | None = field("Percent of all functions of which a line must be run.", default=None)
    minimum_functions_change: Percent | None = field(
        "Percent of the functions that the change touches of which a line must be run.", default=None
    )
    pseudo_tested: Literal["none", "change", "all"] | None = field(
        "Look for functions that tests run and do not test: none, of the change, or all (what a limit needs, or none).",
        default=None,
    )
    max_pseudo_tested: Annotated[int, at_least(0)] | None = field(
        "Most functions that tests run and do not test.", default=None
    )
    max_pseudo_tested_change: Annotated[int, at_least(0)] | None = field(
        "Most functions of the change that tests run and do not test.", default=None
    )
    pseudo_tested_budget: str = field("How long to look for these, such as 10m (10m).", default="10m")
    base: str | None = field("Branch or commit that the change goes to (from the event).", default=None)
    badge: Path | None = field("Write a badge of the coverage to this SVG file.", default=None)
    service: Literal["codacy", "none"] | None = field(
        "Service that receives the coverage: codacy or none (none).", default=None
    )
    project_token: str | None = field(
        "Codacy token of this repository; locally in CODACY_PROJECT_TOKEN.", default=None, repr=False
    )
    api_token: str | None = field("Codacy token of an account; locally in CODACY_API_TOKEN.", default=None, repr=False)
    provider: str | None = field(
        "With api-token, the host of the repository: gh, ghe, gl, gle, bb or bbe.", default=None
    )
    organisation: str | None = field("With api-token, the organisation of the repository.", default=None)
    repository: str | None = field("With api-token, the repository's name.", default=None)
    api_url: str | None = field("The address of Codacy's API (https://api.codacy.com).", default=None)
    language: str | None = field("The language of all files for Codacy (derived from their suffix).", default=None)
    partial: bool = field("Other jobs upload coverage of this commit too; the last of them sets final.", default=False)
    final: bool = field(
        "This is the last upload for this commit; without tests and reports, only that is sent.", default=False
    )
    if_token_missing: Literal["fail", "skip"] = field(
        "fail or skip where there is no token (fail; forks are skipped).",
        default="fail",
    )
    commit: str | None = field(
        "The commit that the coverage belongs to (from the event or the checkout).", default=None
    )
    dry_run: bool = field("Send nothing, and show the requests.", default=False)
    output: Path | None = field(
        "Folder for results.json, junit.xml, summary.md, lcov.info, tests.xml and logs.", default=None
    )

    @property
    def pseudo_tested_scope(self) -> Literal["none", "change", "all"]:
        """Which functions are judged by replacing them."""
        if self.pseudo_tested is not None:
            return self.pseudo_tested
        if self.max_pseudo_tested is not None:
            return "all"
        return "none" if self.max_pseudo_tested_change is None else "change"


def upload(settings: CoverageSettings, runner: Runner) -> ExitCode:
    """Run the tests or read reports, judge, upload, and report.

    Raises:
        InputError: an input or a report is wrong or missing.
        InfrastructureError: the tests exceed the time limit, or a result cannot be written. A result of an earlier run
            is removed first, so that it is not mistaken for this one's.
    """
    if settings.output is not None:
        uploads = [file.name for file in settings.output.glob("upload-*.json")]
        remove_results(settings.output, (*FILES, BRIEF_FILE, LCOV_FILE, "tests.xml", "tests.log", LOG_FILE, *uploads))
    _check_settings(settings)
    settings = replace(settings, service=settings.service or "none")
    repository = Repository.around(settings.directory)
    event = event_of(os.environ)
    commit, source = find_commit(settings.commit, event, repository)
    runner.log(f"commit {commit} ({source})")
    service, skipped = _find_service(settings, event)
    if settings.tests is None and not settings.reports:
        return _only_final(settings, commit, service, skipped, runner)
    with temporary_folder(prefix="calibration-coverage-") as folder:
        results = _measure_and_judge(settings, repository, event, commit, folder, runner)
    results = replace(results, upload=_upload_coverage(results, settings, service, skipped, runner))
    if settings.badge is not None:
        write_atomically(settings.badge, badge(results.lines, results.goal))
    return publish(report(results, settings.directory, settings.badge), runner, settings.output)


def _check_settings(settings: CoverageSettings) -> None:
    if settings.partial and settings.final:
        raise InputError("partial and final are both given: partial announces more uploads, final is the last one")
    if settings.tests is None and not settings.reports and not settings.final:
        raise InputError("neither run nor reports is given: set run to the test command, or reports to existing files")
    if settings.interpreter and settings.tests is None:
        raise InputError("interpreter is given without tests: it applies only to that command")
    if settings.tests is None and (wanted := settings.pseudo_tested_scope) != "none":
        raise InputError(
            f"pseudo-tested: found {wanted} without tests: functions are replaced while the tests run again"
        )
    parse_seconds(settings.pseudo_tested_budget, "pseudo-tested-budget")
    limits = {"all": settings.max_pseudo_tested, "change": settings.max_pseudo_tested_change}
    for scope, limit in limits.items():
        if limit is not None and settings.pseudo_tested_scope not in (scope, "all"):
            expected = "all" if scope == "all" else "change or all"
            raise InputError(f"pseudo-tested: found {settings.pseudo_tested}, expected {expected} for its limit")
    given = [name for name in FOR_SERVICE if getattr(settings, name)]
    if settings.service is None and given:
        name = given[0].replace("_", "-")
        raise InputError(f"{name} is given without a service: add service: codacy (or none, to upload nothing)")


def _find_service(settings: CoverageSettings, event: Event) -> tuple[Codacy | None, str]:
    """Return the client of the service, or None and the reason.

    Raises:
        InputError: a required token is missing, or an input of the service is malformed.
    """
    if settings.service == "none":
        return None, ""
    account = parse_account(
        settings.project_token, settings.api_token, settings.provider, settings.organisation, settings.repository
    )
    if account is None and settings.dry_run:
        account = Account("", settings.provider, settings.organisation, settings.repository)
    if account is not None:
        return Codacy(account, parse_api_url(settings.api_url or API_URL), settings.language), ""
    if event.without_secrets is not None:
        return None, event.without_secrets
    if settings.if_token_missing == "skip":  # noqa: S105 (no password)
        return None, "there is no token"
    raise InputError(
        "CODACY_PROJECT_TOKEN is not set, nor CODACY_API_TOKEN: put the token there (in the action: project-token), "
        "or set service: none"
    )


def _measure_and_judge(
    settings: CoverageSettings, repository: Repository, event: Event, commit: str, folder: Path, runner: Runner
) -> CoverageResults:
    """Run the tests if a command is given, and judge their coverage."""
    sources = find_sources(repository, settings.directory, map(Path, settings.source), settings.exclude)
    options = team_settings(settings.directory)
    base, no_change = _find_base(settings, repository, event)
    tests: Tests | None = None
    files: list[Path] = []
    executable = None
    begin = time.time()
    if settings.tests is not None:
        tests, files, executable = _run_tests(settings, sources, options, folder, runner)
    failed = tests is not None and tests.problem is not None
    try:
        if settings.reports:
            files = _find_reports(settings, None if tests is None else begin)
        found = read_reports(files, sources, options, folder / "reading", executable)
    except InputError as error:
        if not failed:
            raise
        found = Found({})  # failed tests may have written no report
        runner.log(one_line(f"no coverage: {error}"))
    change = None
    touched: dict[str, set[int]] = {}
    if base is not None:
        difference = repository.difference(base)
        if unread := sorted(files_without_lines(difference) & found.files.keys()):
            raise InputError(
                f"{unread[0]}: its changed lines are not known, as git takes it for a binary file: take it out of the "
                "lines with -diff or binary in .gitattributes, or exclude it"
            )
        touched = changed_lines(difference)
        change = coverage_of_change(base, touched, found.files)
    results = CoverageResults(found, settings.goal, commit, tests, change, no_change)
    if results.lines.total == 0 and not failed:
        why = "; ".join(
            ["the reports contain no file that counts (source, exclude)", *what_is_left_out(found.left_out)]
        )
        raise InputError(f"no executable line was found: {why}")
    results = replace(results, limits=_coverage_limits(settings, results))
    if settings.pseudo_tested_scope == "none":
        return results
    if failed or (base is None and settings.pseudo_tested_scope == "change"):
        return replace(results, no_pseudo_tested="the tests fail" if failed else no_change)
    judged = _pseudo_tested(settings, sources, touched, folder, runner)
    return replace(results, pseudo_tested=judged, pseudo_tested_limits=tuple(_pseudo_tested_limits(settings, judged)))


def _coverage_limits(settings: CoverageSettings, results: CoverageResults) -> tuple[CoverageLimit, ...]:
    limits = [
        ("minimum", settings.minimum, results.lines, "lines", False),
        ("minimum-functions", settings.minimum_functions, results.functions, "functions", False),
    ]
    if (change := results.change) is not None:
        limits += [
            ("minimum-change", settings.minimum_change, change.rate, "lines", True),
            ("minimum-functions-change", settings.minimum_functions_change, change.functions, "functions", True),
        ]
    return tuple(
        CoverageLimit(name, minimum, rate, what, of_change)
        for name, minimum, rate, what, of_change in limits
        if minimum is not None
    )


def _pseudo_tested(
    settings: CoverageSettings, sources: Sources, touched: Mapping[str, set[int]], folder: Path, runner: Runner
) -> PseudoTestedResults:
    """Find the functions that tests run and do not test, those that the change touches first."""
    functions: list[PythonFunction] = []
    changed: set[int] = set()
    for path in sources.counted:
        if language_of(path) == PYTHON_LANGUAGE:
            for function in functions_of(path, (sources.repository.root / path).read_bytes()):
                is_changed = any(function.first <= line <= function.last for line in touched.get(path, ()))
                if not function.trivial and (is_changed or settings.pseudo_tested_scope == "all"):
                    changed |= {len(functions)} if is_changed else set()
                    functions.append(function)
    seconds = parse_seconds(settings.pseudo_tested_budget, "pseudo-tested-budget")
    return find_pseudo_tested(
        functions,
        frozenset(changed),
        _parse_command(settings, folder),
        sources,
        seconds,
        (settings.output or folder).absolute(),
        runner,
        _secrets(settings),
    )


def _pseudo_tested_limits(settings: CoverageSettings, judged: PseudoTestedResults) -> Iterator[PseudoTestedLimit]:
    unjudged = [each for each in judged.unjudged if each.reason == OVER_BUDGET]
    if settings.max_pseudo_tested_change is not None:
        of_change = sum(each.changed for each in unjudged)
        yield PseudoTestedLimit(
            "max-pseudo-tested-change", settings.max_pseudo_tested_change, judged.found_in_change, of_change
        )
    if settings.max_pseudo_tested is not None:
        yield PseudoTestedLimit("max-pseudo-tested", settings.max_pseudo_tested, len(judged.functions), len(unjudged))


def _find_base(settings: CoverageSettings, repository: Repository, event: Event) -> tuple[str | None, str]:
    """Return the merge base of the change; or None and the reason.

    Raises:
        InputError: it is required, and cannot be found.
    """
    try:
        return find_base(repository, settings.base, event.bases), ""
    except InputError as error:
        needed = (settings.minimum_change, settings.minimum_functions_change, settings.max_pseudo_tested_change)
        if settings.base is not None or any(limit is not None for limit in needed):
            raise
        return None, str(error)


def _find_reports(settings: CoverageSettings, begin: float | None) -> list[Path]:
    """Return the report files.

    Raises:
        InputError: a pattern matches no file, or a file is older than the test run that should have written it.
    """
    files = [Path(file) for file in matching([str(settings.directory / name) for name in settings.reports])]
    for file in files:
        if begin is not None and file.exists() and file.stat().st_mtime < begin - CLOCK_TOLERANCE:
            raise InputError(f"{file}: it is older than this run of the tests, which should have written it (reports)")
    return files


def _run_tests(
    settings: CoverageSettings, sources: Sources, options: Mapping[str, Any], folder: Path, runner: Runner
) -> tuple[Tests, list[Path], str | None]:
    """Run the tests; return their outcome, the measured data files, and the Python that measured."""
    seconds = parse_seconds(settings.timeout, "timeout")
    output = (settings.output or folder).absolute()
    environment = plain(os.environ)
    called = _parse_command(settings, folder)
    if not settings.reports:  # otherwise the tests measure themselves
        environment = measured_environment(os.environ, options, sources.measured(), folder / "measuring")
    log = output / "tests.log"
    tests = run_tests(called, settings.directory, environment, seconds, runner, log, _secrets(settings))
    if settings.reports:
        return tests, [], None
    measured = measurement(folder / "measuring")
    for problem in measured.problems:
        runner.log(one_line(problem))
    if not measured.files and tests.problem is None:
        why = "; ".join(measured.problems) or (
            "no Python was started that uses PYTHONPATH; if the tests measure themselves, set reports"
        )
        raise InputError(f"tests: the tests passed, but no coverage was measured: {why}")
    return tests, list(measured.files), measured.executable


def _parse_command(settings: CoverageSettings, folder: Path) -> CommandOfTests:
    junit = (settings.output or folder).absolute() / "tests.xml"
    return parse_command(settings.tests or "", settings.directory, settings.interpreter, plain(os.environ), junit)


def _secrets(settings: CoverageSettings) -> tuple[str, ...]:
    return tuple(filter(None, (settings.project_token, settings.api_token)))


def _only_final(
    settings: CoverageSettings, commit: str, service: Codacy | None, skipped: str, runner: Runner
) -> ExitCode:
    """Tell the service that the uploads for the commit are complete."""
    state: State = "none" if settings.service == "none" else "skipped"
    if service is not None:
        requests = service.requests(Upload(commit, {}, final=True))
        state = _send_requests(service, requests, settings, runner)
    set_outputs(runner, {"uploaded": state, "commit": commit})
    runner.log(f"{state}{f': {skipped}' if skipped else ''}: no more uploads for {commit}")
    return ExitCode.PASS


def _upload_coverage(
    results: CoverageResults, settings: CoverageSettings, service: Codacy | None, skipped: str, runner: Runner
) -> Uploaded:
    """Upload the coverage, and return the outcome."""
    name = settings.service or "none"
    if service is None:
        return Uploaded(name, "none" if name == "none" else "skipped", skipped)
    if results.lines.total == 0:
        return Uploaded(name, "skipped", "nothing was measured")
    upload = Upload(results.commit, results.files, settings.partial, settings.final)
    try:
        return Uploaded(name, _send_requests(service, service.requests(upload), settings, runner))
    except InfrastructureError as error:
        return Uploaded(name, "failed", str(error))


def _send_requests(service: Codacy, requests: Sequence[Request], settings: CoverageSettings, runner: Runner) -> State:
    """Send the requests, or only log them in a dry run.

    Raises:
        InfrastructureError: the service rejected one.
    """
    for request in requests:
        verb = "would be sent" if settings.dry_run else "sent"
        runner.log(one_line(f"{request.what}: {len(request.body)} bytes of JSON {verb} to {request.url}"))
    if settings.dry_run:
        for number, request in enumerate(requests, 1):
            if settings.output is not None:
                write_atomically(settings.output / f"upload-{number}.json", request.body)
        return "dry-run"
    service.send(requests)
    return "uploaded"


@click.command(TITLE)
@record_options(CoverageSettings)
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Run tests, check their coverage, and upload it.

    The verdict is fail if a test fails, no test runs, or a limit is broken.
    """
    runner = Runner.from_environment(os.environ)
    return upload(settings_from(options, click_context, runner), runner)


def settings_from(options: dict[str, Any], click_context: click.Context, runner: Runner) -> CoverageSettings:
    """Create the settings from the options and Codacy's variables; tokens are masked immediately.

    Raises:
        InputError: a token is on the command line.
    """
    for name, variable in (TOKEN_VARIABLES | CODACY_VARIABLES).items():
        options[name] = options[name] or os.environ.get(variable, "").strip() or None
    for name, variable in TOKEN_VARIABLES.items():
        place = f"the environment variable {variable}"
        masked_secret(click_context, name.replace("_", "-"), options[name], runner, place)
    if any(options[name] for name in TOKEN_VARIABLES):
        hide(
            [*TOKEN_VARIABLES.values(), *(f"INPUT_{name.upper()}" for name in TOKEN_VARIABLES)]
        )  # the tests are untrusted programs
    return chosen(CoverageSettings, options)
