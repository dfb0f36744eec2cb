"""Results of tests in the image: verdicts of runs by their files and ends, documents, and the report."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.addons.image_tests.settings import COVERAGE_FOLDER, ImageTests
from calibration.base import ExitCode, InputError, count_of, one_line, read_bytes, shorten
from calibration.base.records import computed, field, result
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, End, JobOutcome
from calibration.ci.report import Block, Code, Lines, Outcome, Report, Table, Verdict, verdict_of
from calibration.ci.report.junit import CaseOutcome, ErrorCode, RepeatedFailure, Tally, read_test_report
from calibration.ci.report.report import StageResult
from calibration.ci.workflow.runner import Annotation, Level

MAX_REPORT_BYTES = 100 * 1024 * 1024
MAX_CASES = 200_000
"""Limit of the tests of one run."""
MAX_LOG_LINES, MAX_LOG_TAIL_BYTES = 20, 64 * 1024
"""Limits of what is kept of the container's last output."""
RUN_CASE = "(the run)"
"""Case that stands for the run itself: it fails if its process crashes or hangs, or if a report is missing or bad."""
_ENDS_CUT_SHORT = (End.TIMED_OUT, End.SIGNALLED, End.OUT_OF_MEMORY)
"""Ends of a container after which tests may not have run, whatever the reports say."""
_BYTES_OF_ROOT = 4096
_ROOTS_OF_REPORTS = (b"<testsuite", b"<Site")


@dataclass(frozen=True)
class JudgedRun:
    """One run of the tests of an entry."""

    cases: tuple[CaseOutcome, ...]
    """Outcomes of its tests; the last one is that of the run itself (`RUN_CASE`)."""
    seconds: float
    folder: Path
    """Folder of its job."""
    coverage: tuple[Path, ...] = ()
    """Files of coverage."""
    log: Path | None = None
    last_lines: tuple[str, ...] = ()
    """The container's last output, if the run itself has failed."""
    error: ExitCode | None = None
    """Exit code of a run that could not be made."""

    @property
    def tally(self) -> Tally:
        """Numbers of its tests, without the run itself."""
        return Tally.of(self.cases[:-1])

    @property
    def passes(self) -> bool:
        """Whether every test passed, and the run itself."""
        return all(case.state != "failed" for case in self.cases)


def judge_run(tests: ImageTests, outcome: JobOutcome) -> JudgedRun:
    """Read the reports of a run, and judge its end."""
    files = outcome.folder / ARTIFACTS_FOLDER
    cases: list[CaseOutcome] = []
    problems: list[str] = []
    for name in sorted(file.path for file in outcome.artifacts if _is_report(files / file.path)):
        try:
            cases += read_test_report(read_bytes(files / name, MAX_REPORT_BYTES, "a report of tests"), name)
        except InputError as error:
            problems.append(str(error).replace(f"{files}/", ""))
        if len(cases) > MAX_CASES:
            problems.append(f"{name}: found more than {MAX_CASES} tests, the limit of a run")
            break
    container = next((each for each in outcome.containers if each.log is not None), None)
    log = container.log if container else None
    timed_out = any(each.end == End.TIMED_OUT for each in outcome.containers)
    cut_short = any(each.end in _ENDS_CUT_SHORT for each in outcome.containers)
    tally = Tally.of(cases)
    if cut_short or (outcome.exit_code != ExitCode.PASS and not tally.failed):
        problems = [*outcome.reasons, *problems]  # of failed tests it is only the consequence
    elif not tally.ran and not tests.allow_no_tests:
        skipped = f" ({tally.skipped} were skipped)" if tally.skipped else ""
        problems.insert(0, f"no test ran{skipped}: found no report with tests, expected JUnit or CTest XML")
    message = shorten(one_line("; ".join(problems)), 500)
    itself = CaseOutcome(RUN_CASE, message, state="failed" if problems else "passed", seconds=outcome.seconds)
    not_made = outcome.exit_code in (ExitCode.BAD_INPUT, ExitCode.INFRASTRUCTURE) and not timed_out
    return JudgedRun(
        (*map(_bounded, cases[:MAX_CASES]), itself),
        round(outcome.seconds, 3),
        outcome.folder,
        tuple(_coverage_files(tests, outcome)),
        log,
        _last_lines(log) if problems and log else (),
        outcome.exit_code if not_made else None,
    )


def _is_report(path: Path) -> bool:
    """Return whether a file is a report of tests, or an XML file that is to be one: not one of coverage."""
    try:
        with path.open("rb") as file:
            start = file.read(_BYTES_OF_ROOT)
    except OSError:
        return False
    if any(root in start for root in _ROOTS_OF_REPORTS):
        return True
    return path.suffix == ".xml" and b"<coverage" not in start


def _coverage_files(tests: ImageTests, outcome: JobOutcome) -> Iterator[Path]:
    for file in outcome.artifacts:
        path = outcome.folder / ARTIFACTS_FOLDER / file.path
        if file.path.startswith(f"{COVERAGE_FOLDER}/") or (tests.coverage_files and not _is_report(path)):
            yield path


def _last_lines(log: Path) -> tuple[str, ...]:
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - MAX_LOG_TAIL_BYTES))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ()
    return tuple(one_line(line) for line in lines if line.strip())[-MAX_LOG_LINES:]


def _bounded(case: CaseOutcome) -> CaseOutcome:
    return case if case.name != RUN_CASE else replace(case, name=f"{RUN_CASE} in a report")


MAX_NAMED_TESTS = 20
"""Limit of the tests that reasons and warnings of one entry name."""


@result
class TestRun:
    """One run of the tests of an entry."""

    __test__ = False  # keeps pytest from collecting it

    passed: int = field("Number of tests that passed.")
    failed: int = field("Number of tests that failed.")
    skipped: int = field("Number of tests that were skipped.")
    seconds: float = field("How long the run took.")
    retries: int = field("How often it was repeated because it failed; the numbers are of the last time.", default=0)
    folder: str = field("Folder of its reports and its log, relative to the output folder.", default="")
    last_lines: tuple[str, ...] = field("Last output of its container, if the run itself failed.", default=())
    verdict: Verdict = field("Fail if a test failed, or the run itself.", default="pass")


@result(kw_only=True)
class TestsOfEntry:
    """Results of one entry of ``tests``."""

    __test__ = False

    name: str = field("The entry in calibration.yml.")
    image: str = field("The image.")
    runs: tuple[TestRun, ...] = field("Its runs, in order.")
    failures: tuple[RepeatedFailure, ...] = field("Tests that failed at least once; those that always fail first.")
    coverage: tuple[str, ...] = field("Files of coverage, relative to the output folder, for coverage-upload.")
    max_flake_rate: float | None = field("Largest share of runs in which a flaky test may fail.", default=None)
    error: ErrorCode | None = field("Exit code of a run that could not be made.", default=None)

    @property
    def tolerated(self) -> tuple[RepeatedFailure, ...]:
        """Flaky tests that do not fail the verdict: within the allowed rate; without one those that a retry passed."""
        return tuple(test for test in self.failures if self._is_tolerated(test))

    def _is_tolerated(self, test: RepeatedFailure) -> bool:
        if self.max_flake_rate is not None:
            return test.is_within(self.max_flake_rate)
        return test.flaky and all(run.verdict == "pass" for run in self.runs)

    @property
    @computed()
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict, one line each."""
        failing = [test for test in self.failures if not self._is_tolerated(test)]
        lines = [self._failure_line(test) for test in failing[:MAX_NAMED_TESTS]]
        more = len(failing) - MAX_NAMED_TESTS
        return lines + ([f"{self.name}: and {count_of(more, 'more test')} failed"] if more > 0 else [])

    def _failure_line(self, test: RepeatedFailure) -> str:
        return f"{self.name if test.name == RUN_CASE else f'{self.name}: {test.name}'} {test}"

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if a test fails beyond the allowed rate, or none ran."""
        return verdict_of(not self.reasons and self.error is None)


def results_of_entry(
    tests: ImageTests, attempts: Sequence[Sequence[JudgedRun]], failures: Sequence[RepeatedFailure], output: Path
) -> TestsOfEntry:
    """Return the results of an entry.

    Args:
        tests: the entry.
        attempts: of each run its attempts.
        failures: tests that failed, at their places in the repository.
        output: folder to which paths are relative.
    """
    last = [each[-1] for each in attempts]
    return TestsOfEntry(
        name=tests.name,
        image=tests.container.image,
        runs=tuple(_test_run(each, output) for each in attempts),
        failures=tuple(failures),
        coverage=tuple(str(path.relative_to(output)) for run in last for path in run.coverage),
        max_flake_rate=tests.max_flake_rate,
        error=next((run.error for run in last if run.error is not None), None),
    )


def _test_run(attempts: Sequence[JudgedRun], output: Path) -> TestRun:
    last = attempts[-1]
    return TestRun(
        passed=last.tally.passed,
        failed=last.tally.failed,
        skipped=last.tally.skipped,
        seconds=last.seconds,
        retries=len(attempts) - 1,
        folder=str(last.folder.relative_to(output)),
        last_lines=last.last_lines,
        verdict=verdict_of(last.passes),
    )


@result
class ImageTestsResults:
    """Results of test-image."""

    tests: tuple[TestsOfEntry, ...] = field("The entries.")
    notes: tuple[str, ...] = field("What is worth knowing: flaky tests that are allowed, how rare a flake shows.")

    @property
    @computed()
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict, one line each."""
        return [reason for each in self.tests for reason in each.reasons]


@result(kw_only=True)
class Tested(StageResult):
    """Tests in the image."""

    heading = "Tests in the image"

    passed: int = field("Number of tests that passed, of all entries and runs.")
    failed: int = field("Number of tests that failed.")

    @property
    def sentence(self) -> str:
        """Return the number of tests, for the line of the verdict."""
        return f"{self.failed} of {count_of(self.passed + self.failed, 'test')} in the image failed"


TITLE = "test-image"
MAX_FAILURE_ROWS, MAX_TIMED_TESTS = 200, 10
_COLUMNS = ("tests", "runs", "passed", "failed", "skipped", "flaky", "seconds")


def report(results: ImageTestsResults, last_runs: Mapping[str, Sequence[JudgedRun]], output: Path) -> Report:
    """Return the report.

    Args:
        results: what was found.
        last_runs: the runs of each entry, by its name, each as it ended.
        output: folder to which the paths in the results are relative.
    """
    errors = [each.error for each in results.tests if each.error is not None]
    reasons = tuple(results.reasons)
    return Report(
        title="Tests in the image",
        verdict=verdict_of(not reasons and not errors),
        error=max(errors, default=None),
        sentence=_sentence(results),
        reasons=reasons,
        notes=results.notes,
        annotations=tuple(_annotations(results)),
        blocks=tuple(_blocks(results, last_runs)),
        suites={name: list(_junit_cases(name, runs)) for name, runs in last_runs.items()},
        results=results,
        outputs={
            "passed": sum(run.passed for each in results.tests for run in each.runs),
            "failed": sum(run.failed for each in results.tests for run in each.runs),
            "flaky": sum(test.flaky for each in results.tests for test in each.failures),
            "coverage": "\n".join(str(output / path) for each in results.tests for path in each.coverage),
        },
    )


def _sentence(results: ImageTestsResults) -> str:
    failed = sum(run.failed for each in results.tests for run in each.runs)
    ran = failed + sum(run.passed for each in results.tests for run in each.runs)
    return f"{failed} of {count_of(ran, 'test')} failed"


def _blocks(results: ImageTestsResults, last_runs: Mapping[str, Sequence[JudgedRun]]) -> Iterator[Block]:
    yield Table(_COLUMNS, tuple(_row(each) for each in results.tests))
    failures = tuple((each.name, *_failure_row(test)) for each in results.tests for test in each.failures)
    yield Table(("tests", "test", "failed", "place", "why"), failures, MAX_FAILURE_ROWS, title="Failed")
    for each in results.tests:
        if len(each.runs) > 1:
            rows = tuple(
                (str(number), str(run.passed), str(run.failed), str(run.skipped), f"{run.seconds:.1f}")
                for number, run in enumerate(each.runs, start=1)
            )
            columns = ("run", "passed", "failed", "skipped", "seconds")
            yield Table(columns, rows, title=f"Runs of {each.name}", folded=True, only="summary")
        for number, run in enumerate(each.runs, start=1):
            if run.last_lines:
                yield Code("\n".join(run.last_lines), title=f"Last output of {each.name}, run {number}")
    slowest = sorted(
        ((case.seconds, name, case.name) for name, runs in last_runs.items() for case in runs[-1].cases[:-1]),
        reverse=True,
    )[:MAX_TIMED_TESTS]
    timed = tuple((f"{seconds:.2f}", name, case) for seconds, name, case in slowest if seconds)
    yield Table(("seconds", "tests", "test"), timed, title="Slowest tests", folded=True, only="summary")
    yield Lines(results.notes)


def _row(each: TestsOfEntry) -> tuple[str, ...]:
    counts = (sum(values) for values in zip(*((run.passed, run.failed, run.skipped) for run in each.runs), strict=True))
    flaky = sum(test.flaky for test in each.failures)
    seconds = sum(run.seconds for run in each.runs)
    return (each.name, str(len(each.runs)), *map(str, counts), str(flaky), f"{seconds:.1f}")


def _failure_row(test: RepeatedFailure) -> tuple[str, ...]:
    place = "-" if test.file is None else test.file if test.line is None else f"{test.file}:{test.line}"
    return test.name, f"{test.rate.failed} of {test.rate.runs}", place, test.message


def _annotations(results: ImageTestsResults) -> Iterator[Annotation]:
    """Return an annotation of each failed test whose file is known; the others are among the reasons."""
    for each in results.tests:
        for test in each.failures:
            if test.file is not None and test.name != RUN_CASE:
                level = Level.WARNING if test in each.tolerated else Level.ERROR
                title = "flaky test" if test.flaky else "test failed"
                yield Annotation(f"{test.name}: {test.message}", level, test.file, test.line, title)


def _junit_cases(name: str, runs: Sequence[JudgedRun]) -> Iterator[Outcome]:
    for number, run in enumerate(runs, start=1):
        group = name if len(runs) == 1 else f"{name}.run-{number}"
        for case in run.cases:
            yield Outcome(
                name=case.name,
                group=group,
                reasons=(case.message,) if case.state == "failed" else (),
                skipped="skipped in the image" if case.state == "skipped" else None,
                seconds=case.seconds,
                file=case.file,
                line=case.line,
            )
