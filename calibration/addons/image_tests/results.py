"""Results of tests in the image, their documents, and their report: table, failures, annotations, JUnit cases."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration.addons.image_tests.judging import RUN_CASE, JudgedRun
from calibration.addons.image_tests.settings import ImageTests
from calibration.base.records import computed, field, result
from calibration.base.text import count_of
from calibration.ci.report import Block, Code, Lines, Outcome, Report, Table, Verdict, verdict_of
from calibration.ci.report.junit import ErrorCode
from calibration.ci.report.results_json import StageResult
from calibration.ci.report.xunit_reading import RepeatedFailure
from calibration.ci.workflow.runner import Annotation, Level

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
