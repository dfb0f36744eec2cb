"""Report of ``coverage-upload``: log, summary, annotations and JUnit cases."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from calibration.addons.coverage.formats import Rate, tracefile
from calibration.addons.coverage.pseudo_tested import PseudoTestedResults
from calibration.addons.coverage.reading import UncountedFile
from calibration.addons.coverage.results import CoverageResults
from calibration.base import ExitCode, one_line, shorten
from calibration.ci.report import Lines, Outcome, Report, Table, count_of, outcome_of_check, verdict_of
from calibration.ci.report.blocks import BAD, FAIR, GOOD, NONE, drawn_badge
from calibration.ci.workflow.runner import Annotation, Level

TITLE = "coverage-upload"
LCOV_FILE = "lcov.info"
MAX_ROWS = 200
"""Limit of rows of a table in the log, and of files below the goal; the summary and results.json have all."""
MAX_NAMES = 20
"""Limit of names in a list."""
_HEADER_OF_FILES = ("file", "lines", "branches", "functions", "goal", "not run")
_HEADER_OF_PSEUDO_TESTED = ("function", "place", "passes also when it", "only run by")
MAX_TESTS = 3
"""Limit of tests that are named for a function; results.json has all."""


def report(results: CoverageResults, directory: Path = Path(), badge: Path | None = None) -> Report:
    """Return the report.

    Args:
        results: what was found.
        directory: where the tests ran; their files are named relative to it.
        badge: file of the badge, if one was written.
    """
    below, total = results.below_goal, (_total_row(results),)
    rows = _rows_of_files(results, sorted(results.files))
    not_passed = f"{len(below)} of {len(rows)} files are below the goal of {results.goal:g} %"
    verdict = verdict_of(not results.problems)
    return Report(
        title="Coverage of the tests",
        verdict=verdict,
        error=ExitCode.INFRASTRUCTURE
        if verdict == "pass" and (results.upload.state == "failed" or results.undecided)
        else None,
        sentence=_verdict_sentence(results),
        reasons=tuple(results.problems),
        annotations=tuple(_annotations_of(results, directory)),
        blocks=(
            Table(_HEADER_OF_FILES, (*total, *_rows_of_files(results, _by_rate(results))), MAX_ROWS, only="log"),
            Table(("", "run", "of"), tuple(_summary_rows(results)), only="summary"),
            Lines(tuple(remarks(results))),
            Lines(tuple(_lines_of_comment(results)), only="comment", brief=True),
            *_pseudo_tested_table(results.pseudo_tested),
            Table(_HEADER_OF_FILES, _rows_of_files(results, below), MAX_ROWS, title=not_passed, only="summary"),
            Table(_HEADER_OF_FILES, (*total, *rows), title=f"All {len(rows)} files", only="summary", folded=True),
        ),
        suites={TITLE: list(_junit_cases(results))},
        results=results,
        outputs={
            "line-rate": results.lines.percent,
            "branch-rate": results.branches.percent,
            "function-rate": results.functions.percent,
            "change-rate": results.change.rate.percent if results.change else None,
            "change-function-rate": results.change.functions.percent if results.change else None,
            "pseudo-tested": len(results.pseudo_tested.functions) if results.pseudo_tested else None,
            "pseudo-tested-change": results.pseudo_tested.found_in_change if results.pseudo_tested else None,
            "files-below-goal": len(below),
            "uploaded": results.upload.state,
            "commit": results.commit,
            "badge": badge,
        },
        # so that a separate job, in which no test runs, can upload it
        files={LCOV_FILE: tracefile(results.files).encode("utf-8", "surrogateescape")} if results.lines.total else {},
    )


def _verdict_sentence(results: CoverageResults) -> str:
    parts = results.problems or results.undecided or [f"{results.lines} of the lines are run"]
    state = {
        "uploaded": f"uploaded to {results.upload.service}",
        "skipped": f"not uploaded ({results.upload.reason})",
        "failed": "the upload failed",
        "dry-run": "nothing was sent (dry-run)",
        "none": "",
    }[results.upload.state]
    return one_line(f"{'; '.join(parts)}{'; ' if state else ''}{state}")


def _lines_of_comment(results: CoverageResults) -> Iterator[str]:
    if results.tests is not None and results.tests.tally is not None:
        yield f"{count_of(results.tests.tally.passed, 'test')} passed, {results.tests.tally.failed} failed"
    if results.change is not None:
        yield f"{results.change.rate} of the lines of the change are run"


def remarks(results: CoverageResults) -> list[str]:
    """Return remarks that explain the numbers, a line for each."""
    lines = []
    if results.tests is not None and results.lines.total and not results.lines.covered:
        lines.append("not a line is run: tests that measure themselves (pytest-cov) name their report (reports)")
    if results.change is not None:
        lines.append(f"change since {results.change.base[:12]}: {results.change.rate} of its lines are run")
    elif results.no_change:
        lines.append(f"no coverage of the change: {results.no_change}")
    if results.no_pseudo_tested:
        lines.append(f"no functions are looked for that tests run and do not test: {results.no_pseudo_tested}")
    return lines + _remarks_on_pseudo_tested(results.pseudo_tested) + what_is_left_out(results.left_out)


def _remarks_on_pseudo_tested(found: PseudoTestedResults | None) -> list[str]:
    if found is None:
        return []
    lines = [
        f"{len(found.functions)} of {found.judged} functions that tests run are not tested ({found.seconds:.0f} s)"
    ]
    if found.failing:
        lines.append(
            f"these tests do not pass in a copy of the checkout, and judge nothing: {_names_text(found.failing)}"
        )
    reasons = Counter(each.reason for each in found.unjudged)
    lines += [f"{count} functions that tests run are not judged: {reason}" for reason, count in reasons.items()]
    return lines


def _pseudo_tested_table(found: PseudoTestedResults | None) -> Iterable[Table]:
    if found is not None and found.functions:
        rows = tuple(
            (
                each.name,
                f"{each.path}:{each.line}{' (of the change)' if each.changed else ''}",
                " or ".join(each.replacements),
                _names_text(each.tests, MAX_TESTS),
            )
            for each in found.functions
        )
        title = f"{len(rows)} functions that tests run and do not test"
        yield Table(_HEADER_OF_PSEUDO_TESTED, rows, MAX_ROWS, title=title)


def what_is_left_out(found: UncountedFile) -> list[str]:
    """Return a line for each part of the reports that is not counted, and for languages without a report."""
    lines = []
    if found.unmatched:
        lines.append(f"in reports, but no file that git tracks: {_names_text(found.unmatched)}")
    for name, paths in list(found.ambiguous.items())[:MAX_NAMES]:
        lines.append(
            f"left out, because it may be several files: {shorten(one_line(name), 200)} ({_names_text(paths)})"
        )
    for path, line in list(found.ill_fitting.items())[:MAX_NAMES]:
        lines.append(f"left out, because a report contains line {line}, which the file lacks: {one_line(path)}")
    if found.unreadable:
        lines.append(f"left out, because coverage.py cannot read or parse them: {_names_text(found.unreadable)}")
    for language, count in sorted(found.without_report.items()):
        lines.append(f"{count_of(count, f'{language} file')} not counted: no report contains any")
    return lines


def _annotations_of(results: CoverageResults, directory: Path) -> Iterable[Annotation]:
    """Return an annotation of each failed test, of the upload, and of the uncovered lines of the change."""
    for failure in results.tests.tally.failures if results.tests and results.tests.tally else ():
        file = None if failure.file is None else directory / failure.file
        yield Annotation(f"{failure.name}: {failure.message}", file=file, line=failure.line, title="test failed")
    if results.upload.state == "failed":
        yield Annotation(results.upload.reason)
    if results.upload.state == "skipped":
        yield Annotation(f"not uploaded: {results.upload.reason}", Level.NOTICE)
    for span in results.change.missing if results.change else ():
        message = f"no test runs {_lines_text(span.first, span.last)} of this change"
        yield Annotation(message, Level.WARNING, span.path, span.first, title="not covered")
    for reason in results.undecided:
        yield Annotation(reason)
    for each in results.pseudo_tested.functions if results.pseudo_tested else ():
        message = (
            f"no test fails when {each.name} {' or '.join(each.replacements)} instead: "
            f"{_names_text(each.tests, MAX_TESTS)} only run{'s' if len(each.tests) == 1 else ''} it"
        )
        yield Annotation(message, Level.WARNING, each.path, each.line, title="pseudo-tested")


def _junit_cases(results: CoverageResults) -> Iterable[Outcome]:
    """Return the JUnit cases: the tests as a whole, each limit, and the upload."""
    if results.tests is not None:
        problem = results.tests.problem
        yield Outcome(name="tests", group=TITLE, reasons=(problem,) if problem else (), seconds=results.tests.seconds)
    for limit in results.limits:
        yield replace(outcome_of_check(limit.check, TITLE), name=f"{limit.name} {limit.minimum:g} %")
    for maximum in results.pseudo_tested_limits:
        undecided = (maximum.undecided,) if maximum.undecided else ()
        outcome = outcome_of_check(maximum.check, TITLE)
        yield replace(
            outcome,
            name=f"{maximum.name} {maximum.maximum}",
            reasons=outcome.reasons or undecided,
            error=ExitCode.INFRASTRUCTURE if undecided else None,
        )
    if results.upload.state != "none":
        failed, skipped = (results.upload.state == state for state in ("failed", "skipped"))
        yield Outcome(
            name=f"upload to {results.upload.service}",
            group=TITLE,
            reasons=(results.upload.reason,) if failed else (),
            error=ExitCode.INFRASTRUCTURE if failed else None,
            skipped=results.upload.reason if skipped else None,
        )


def _summary_rows(results: CoverageResults) -> list[tuple[str, str, str]]:
    rates = [("lines", results.lines), ("branches", results.branches), ("functions", results.functions)]
    if results.change is not None:
        rates.append(("lines of the change", results.change.rate))
        rates.append(("functions of the change", results.change.functions))
    rows = [(name, str(rate).partition(" (")[0], f"{rate.covered} of {rate.total}") for name, rate in rates]
    tally = results.tests.tally if results.tests is not None else None
    if tally is not None:
        skipped = f", {tally.skipped} skipped" if tally.skipped else ""
        rows.append(("tests", f"{tally.passed} passed", f"{tally.ran} run{skipped}"))
    return rows


def _rows_of_files(results: CoverageResults, paths: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    below = set(results.below_goal)
    return tuple(
        (
            path,
            str(results.files[path].line_rate),
            str(results.files[path].branch_rate),
            str(results.files[path].function_rate),
            "" if not results.files[path].hits else "below" if path in below else "above",
            shorten(", ".join(_span_text(*part) for part in results.files[path].ranges(results.files[path].missing))),
        )
        for path in paths
    )


def _total_row(results: CoverageResults) -> tuple[str, ...]:
    below = len(results.below_goal)
    rates = (str(results.lines), str(results.branches), str(results.functions))
    return "total", *rates, f"{below} below {results.goal:g} %", ""


def _by_rate(results: CoverageResults) -> list[str]:
    rates = results.line_rates()
    return sorted(rates, key=lambda path: (rates[path].covered / max(rates[path].total, 1), path))


def _lines_text(first: int, last: int) -> str:
    return f"line {first}" if first == last else f"lines {first} to {last}"


def _span_text(first: int, last: int) -> str:
    return str(first) if first == last else f"{first}-{last}"


def _names_text(names: Sequence[str], most: int = MAX_NAMES) -> str:
    shown = ", ".join(shorten(one_line(name), 200) for name in names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown


def badge(lines: Rate, goal: float) -> str:
    """Draw a badge as SVG: green from the goal on, brown from three quarters of it, else red."""
    text = "unknown" if lines.percent is None else f"{int(lines.percent)}%"
    if lines.total == 0:
        colour = NONE
    elif lines.reaches(goal):
        colour = GOOD
    else:
        colour = FAIR if lines.reaches(0.75 * goal) else BAD
    return drawn_badge("coverage", text, colour)
