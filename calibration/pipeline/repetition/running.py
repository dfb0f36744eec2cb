"""The loop of repeated runs: each in a folder of its own, kept whatever happens to the next; and their report."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from calibration.base import CalibrationError, ExitCode, count_of, one_line
from calibration.base.addons import import_attribute, of_addons
from calibration.base.verdict import MAX_REPETITIONS, runs_show
from calibration.ci.execution.tasks import locked
from calibration.ci.pages.html import bullets, element, join, page, table, verdict_line
from calibration.ci.report import FILES, Block, Lines, Outcome, Report, Table, remove_results, show
from calibration.ci.report.blocks import BADGE_FILE, verdict_badge
from calibration.ci.report.report import BRIEF_FILE
from calibration.ci.workflow import Runner
from calibration.ci.workflow.runner import OutputValue
from calibration.pipeline.repetition.repetition import (
    Repetition,
    Repetitions,
    numbers_of_run,
    outcomes_of_stages,
    outputs_of_run,
    poses_of_run,
)
from calibration.pipeline.repetition.results import THE_RUN, RepeatedResults, Spread, number_ranges, repeated_results
from calibration.pipeline.results import PAGE_FILE, PipelineResults, reason_of_end
from calibration.pipeline.running import STAGES, PipelineRun, check_stages, run_stages, stages_reported

RUN_PREFIX = "run-"
"""Prefix of the folder of a run; its number follows."""
REPORT_FILES = (*FILES, BRIEF_FILE, PAGE_FILE, BADGE_FILE)


def repeated(
    settings: Repetitions,
    output: Path,
    runner: Runner,
    title: str,
    once: Callable[[Path], Repetition],
    undecided_passes: bool = False,
) -> tuple[RepeatedResults, Report]:
    """Run work as often as it is asked for, compare the runs, and report; the report is not shown yet.

    A run that ends with an error of exit code 1 has failed, and the next one follows. Any other error, and a signal,
    ends all: what the runs before have come to is reported, and the error is raised again.

    Args:
        settings: how often, and what may differ.
        output: folder of the report, and of a folder for each run.
        runner: its log.
        title: of the report.
        once: runs the work once, into a folder.
        undecided_passes: whether an undecided spread counts as passed.

    Raises:
        CalibrationError: a run could not be made, or the report cannot be written.
    """
    runs: list[Repetition] = []

    def written() -> tuple[RepeatedResults, Report]:
        results = repeated_results(settings, runs, output, undecided_passes)
        found = report(results, runs, output, title)
        found.write(output)
        return results, found

    with locked(output):
        remove_results(output, REPORT_FILES)
        for number in range(settings.repeat + 1, MAX_REPETITIONS + 1):  # of more runs into this folder
            if (folder := output / f"{RUN_PREFIX}{number}").exists():
                remove_results(folder, REPORT_FILES)
        for number in range(1, settings.repeat + 1):
            folder, begin = output / f"{RUN_PREFIX}{number}", time.perf_counter()
            try:
                run = once(folder)
            except BaseException as error:  # signals too: the runs before are kept
                run = _cut_short(folder, error, time.perf_counter() - begin)
                if not isinstance(error, CalibrationError) or error.exit_code != ExitCode.FAIL:
                    runner.log(one_line(f"run {number} of {settings.repeat} was cut short: {run.sentence}"))
                    if runs:
                        runs.append(run)
                        with suppress(CalibrationError):  # such as that the disk is full, which is the error
                            written()
                    raise
            runs.append(_with_verdict(replace(run, whole_seconds=time.perf_counter() - begin)))
            runner.log(one_line(f"run {number} of {settings.repeat}: {run.verdict}: {run.sentence}"))
        return written()


def run_of_repetition(run: str | None, folder: Path) -> str | None:
    """Return the name of a repetition in a cloud, where each has its own; None for a new one."""
    return None if run is None else f"{run}-{folder.name}"


def _cut_short(folder: Path, error: BaseException, seconds: float) -> Repetition:
    why = reason_of_end(error)
    code = error.exit_code if isinstance(error, CalibrationError) and error.exit_code > ExitCode.FAIL else None
    return Repetition(folder=folder, sentence=why, whole_seconds=seconds, cut_short=why, error=code)


def _with_verdict(run: Repetition) -> Repetition:
    """Return a run with its own failure as an outcome, if none of its outcomes has failed and its verdict is fail."""
    if run.verdict != "fail" or any(each.verdict == "fail" for each in run.outcomes):
        return run
    return replace(run, outcomes=(*run.outcomes, Outcome(name=THE_RUN, reasons=(run.sentence,))))


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
        files={BADGE_FILE: verdict_badge(results.verdict)},
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


AFTER_ALL = ("promote", *(name for name, stage in of_addons(lambda addon: addon.stages).items() if stage.last))
"""Stages that follow from the verdict: made once, of the last run, after a pass of all."""


def repeat_stages(run: PipelineRun, stages: Collection[str], settings: Repetitions) -> tuple[ExitCode, PipelineResults]:
    """Run stages as often as it is asked for, and report; return the exit code, and the results of the last run.

    What follows from the verdict (`AFTER_ALL`) is done once.

    Raises:
        InputError: an input is wrong, or another run uses the output folder.
        InfrastructureError: a file cannot be written, a process died, an engine or a registry does not answer.
    """
    if settings.repeat == 1:
        results = run_stages(run, stages)
        return results.exit_code, results
    check_stages(stages)
    last: PipelineRun = run
    outputs: Mapping[str, OutputValue | None] = {}
    tested = [name for name in stages if name not in AFTER_ALL]

    def once(folder: Path) -> Repetition:
        nonlocal last, outputs
        target = replace(run.target, run=run_of_repetition(run.target.run, folder))
        last, found = stages_reported(replace(run, output=folder, target=target), tested)
        results, outputs = last.results, found.outputs
        return Repetition(
            folder=folder,
            verdict=results.verdict,
            sentence=found.sentence,
            seconds=last.seconds,
            outcomes=(*(each for suite in found.suites.values() for each in suite), *outcomes_of_stages(results)),
            numbers=numbers_of_run(results),
            poses=poses_of_run(results, folder, last.given),
            outputs=outputs_of_run(results, folder),
            error=results.exit_code if results.exit_code > ExitCode.FAIL else None,
        )

    passes = all(system.undecided == "pass" for system in run.matrix.systems)
    whole, found = repeated(settings, run.output, run.runner, "Repeated calibration", once, passes)
    for name, stage in STAGES.items():
        if whole.passes and name in AFTER_ALL and name in stages and stage.applies(run):
            last = import_attribute(stage.target)(last)
    outputs = {**outputs, **found.outputs, "output": run.output}
    show(replace(found, outputs=outputs), run.runner, run.output)
    return whole.exit_code, last.results
