"""Results of tests in the image, and their documents."""

from collections.abc import Sequence
from pathlib import Path

from calibration.addons.image_tests.judging import RUN_CASE, JudgedRun
from calibration.addons.image_tests.settings import ImageTests
from calibration.base.records import computed, field, result
from calibration.base.text import count_of
from calibration.ci.report import Verdict, verdict_of
from calibration.ci.report.junit import ErrorCode
from calibration.ci.report.repeated import RepeatedFailure
from calibration.ci.report.stage_result import StageResult

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
