"""Report of repeated runs: times of every run and stage, what varies, from which stage on, and what is flaky."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from calibration.base.flake_rate import runs_show
from calibration.base.text import count_of
from calibration.ci.pages.html import bullets, element, join, page, table, verdict_line
from calibration.ci.report import Block, Lines, Report, Table
from calibration.ci.report.badge import BADGE_FILE, verdict_badge
from calibration.pipeline.repetition.comparison import Spread, number_ranges
from calibration.pipeline.repetition.repetition import Repetition
from calibration.pipeline.repetition.results import RepeatedResults
from calibration.pipeline.results import PAGE_FILE

MAX_SHOWN_SPREADS = 100
RARE_FLAKE = 0.01
"""Rate for which the report says how many runs show it, if no rate is allowed."""


def report(results: RepeatedResults, runs: Sequence[Repetition], output: Path, title: str) -> Report:
    """Return the report, with its page. Its outputs are only those that are of all runs.

    Args:
        results: what was found.
        runs: the runs.
        output: the folder of the results.
        title: of the report and its annotations.
    """
    found = Report(
        title=title,
        verdict=results.verdict,
        error=results.exit_code,
        sentence=_sentence(results),
        reasons=tuple(results.reasons),
        undecided=tuple(results.undecided_lines),
        blocks=tuple(_blocks(results)),
        suites={run.folder.name: list(run.outcomes) for run in runs},
        results=results,
        outputs={"report": output / PAGE_FILE},
        files={BADGE_FILE: verdict_badge("calibration", results.verdict)},
    )
    return replace(found, files={**found.files, PAGE_FILE: _page(found, runs)})


def _sentence(results: RepeatedResults) -> str:
    passed = f"{sum(run.verdict == 'pass' for run in results.runs)} of {count_of(results.asked, 'run')} passed"
    if sum(run.cut_short is None for run in results.runs) <= 1:
        return passed
    if results.spreads:
        return f"{passed}, {len(results.spreads)} of {results.equal + len(results.spreads)} results vary"
    return f"{passed}, {'outputs differ' if results.differences else 'all outputs are equal to the last bit'}"


def _blocks(results: RepeatedResults) -> Iterator[Block]:
    yield runs_table(results)
    failed = tuple((each.name, str(each.rate), number_ranges(each.runs), each.message) for each in results.failures)
    yield Table(("what", "how often", "runs", "why"), failed, title="Failed", brief=True)
    yield Lines(tuple(map(str, results.differences)), title="Runs that differ")
    columns = ("result", "unit", "mean", "standard deviation", "largest difference from it", "limit")
    varying = sorted(results.spreads, key=lambda spread: spread.verdict == "pass")
    yield Table(columns, tuple(map(_spread_row, varying)), MAX_SHOWN_SPREADS, title="Results that vary")
    yield Lines(tuple(_notes(results)))


def runs_table(results: RepeatedResults) -> Table:
    """Return a row for each run with the seconds of its stages, then their means and standard deviations."""
    stages = [spread.name for spread in results.times[:-1]]
    rows = [
        (
            str(number),
            *(_seconds(run.seconds.get(stage)) for stage in stages),
            _seconds(run.whole_seconds),
            run.verdict if run.cut_short is None else "cut short",
        )
        for number, run in enumerate(results.runs, start=1)
    ]
    rows.append(("mean", *(_seconds(spread.mean) for spread in results.times), ""))
    deviations = (spread.standard_deviation if spread.runs > 1 else None for spread in results.times)
    rows.append(("standard deviation", *map(_seconds, deviations), ""))
    columns = ("run", *(f"{stage} (s)" for stage in (*stages, "whole run")), "verdict")
    return Table(columns, tuple(rows) if results.times else (), title="Runs", brief=True)


def _seconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.2f}"


def _spread_row(spread: Spread) -> tuple[str, ...]:
    mean = "-" if spread.mean is None else f"{spread.mean:.6g}"
    limit = "-" if spread.limit is None else f"{spread.limit:g}"
    return spread.name, spread.unit, mean, f"{spread.standard_deviation:.2g}", f"{spread.largest:.2g}", limit


def _notes(results: RepeatedResults) -> Iterator[str]:
    complete = sum(run.cut_short is None for run in results.runs)
    if results.equal and complete > 1:
        yield f"{count_of(results.equal, 'result')} are equal in all runs, to the last bit"
    if complete > 1:
        yield runs_show(complete, "cell or dataset", results.max_flake_rate or RARE_FLAKE)
    yield f"Each run has its own report, such as {results.runs[0].folder}/{PAGE_FILE}"


def _page(found: Report, runs: Sequence[Repetition]) -> str:
    """Return the page, a single file that links to those of the runs."""
    links = [
        element("li", element("a", run.folder.name, href=f"{run.folder.name}/{PAGE_FILE}"), f": {run.verdict}")
        for run in runs
    ]
    parts = [element("h1", found.title), verdict_line(found.verdict, found.sentence), bullets(found.all_reasons)]
    for block in found.blocks:
        parts += [element("h2", block.title)] if block.title and block.plain() else []
        parts.append(
            table(block.columns, block.rows) if isinstance(block, Table) else bullets(block.plain().splitlines())
        )
    return page(f"{found.title}: {found.verdict}", [join([*parts, element("ul", *links)])])
