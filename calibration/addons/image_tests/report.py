"""Report of tests in the image: table, failures, annotations at file and line, JUnit cases."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration.addons.image_tests.judging import RUN_CASE, JudgedRun
from calibration.addons.image_tests.results import ImageTestsResults, TestsOfEntry
from calibration.base.text import count_of
from calibration.ci.report import Block, Code, Lines, Outcome, Report, Table, verdict_of
from calibration.ci.report.repeated import RepeatedFailure
from calibration.ci.workflow.runner import Annotation, Level

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
