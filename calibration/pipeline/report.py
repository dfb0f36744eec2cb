"""Report of a pipeline: its verdict, tables and messages together, and its files."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from calibration.base import write_atomically
from calibration.ci.execution.tasks import Task, cores, run_tasks
from calibration.ci.report import Lines, Outcome, Report, Text, results_text
from calibration.ci.report.blocks import BADGE_FILE as BADGE
from calibration.ci.report.blocks import verdict_badge
from calibration.pipeline import report_blocks
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import CELLS_FILE, Collected, PipelineResults, own_file

NOTES_SHOWN = 30
CELLS_A_PROCESS = 50
"""Least number of cells whose files a process writes: in less time than one takes to begin."""


def write_results(results: PipelineResults, output: Path, stopped: str | None = None) -> None:
    """Write the files of some stages' results into the output folder, for a run of the other stages.

    Args:
        results: the results.
        output: the folder.
        stopped: what stopped the run; the verdict is fail then, since a stage that is missing might have failed.

    Raises:
        InfrastructureError: a file cannot be written.
    """
    write_cells(results, output, 1)
    found = report(results, output)
    if stopped is not None:
        why = f"the run ended early: {stopped}"
        found = replace(
            found,
            verdict="fail",
            sentence=why,
            reasons=(why, *found.reasons),
            suites={**found.suites, "run": [Outcome(name="run", group="run", reasons=(why,))]},
            files={**found.files, BADGE: verdict_badge("fail")},
        )
    found.write(output)


def report(results: PipelineResults, output: Path) -> Report:
    """Return the report.

    Args:
        results: the results.
        output: the folder of the results.
    """
    left_out = tuple(report_blocks.without_result(results))
    numbers = results.summary.all
    main = report_blocks.grid(results)
    if len(results.cells) <= len(results.systems) and not results.comparisons:  # the overview has it
        main = replace(main, only="log")
    return Report(
        title="Calibration",
        verdict=results.verdict,
        error=results.exit_code,
        sentence=report_blocks.verdict_sentence(results),
        reasons=(
            *report_blocks.failures(results),
            *(results.baseline.reasons if results.baseline else ()),
            *(reason for each in results.exports for reason in each.reasons),
            *(reason for each in results.of_stages.all for reason in each.reasons),
        ),
        undecided=tuple(report_blocks.undecided_limits(results, results.systems)),
        about=f"Commit {results.commit}" if results.commit else "",
        warnings=(*report_blocks.findings_of(results, "warning"), *left_out),
        blocks=(
            report_blocks.overview_table(results),
            report_blocks.recordings_table(results),
            main,
            Text(_UNDER_GRID if main.rows and main.only is None else "", only="summary"),
            *map(Text, report_blocks.origin_of_rms(results)),
            replace(report_blocks.truth_table(results), only="log"),
            report_blocks.precision_table(results),
            report_blocks.tasks_table(results),
            Lines(tuple(report_blocks.other_methods(results)), only="summary"),
            report_blocks.transforms_table(results),
            report_blocks.cameras_table(results),
            report_blocks.hangs_on_table(results),
            report_blocks.parameters_table(results),
            report_blocks.changes_table(results),
            report_blocks.updates_table(results),
            Text(report_blocks.baseline_line(results)),
            Lines(tuple(report_blocks.lines_of_comment(results)), only="comment", brief=True),
            report_blocks.collections_table(results),
            Lines(tuple(report_blocks.what_to_record(results)), title="What to record next"),
            Lines(report_blocks.findings_of(results, "warning"), NOTES_SHOWN, title="To look at", only="summary"),
            Lines(report_blocks.findings_of(results, "note"), NOTES_SHOWN, title="Notes"),
            Lines(tuple(report_blocks.export_lines(results, output)), NOTES_SHOWN, title="For the robot"),
            Text(report_blocks.image_line(results.image) if results.image else ""),
            *(Text(each.line(output)) for each in results.of_stages.all),
            Lines(left_out, title="Methods without a result", only="summary"),
        ),
        suites=_junit_suites(results),
        results=results.without_details,
        outputs={
            "output": output,
            "exports": "\n".join(str(output / each.folder) for each in results.exports if each.files),
            "success-rate": numbers.success_rate if results.judged else None,
            "worst-rms-px": numbers.worst_rms_px,
            "worst-translation-mm": numbers.worst_translation_mm,
        },
        files={
            CELLS_FILE: report_blocks.cells_table(results).csv(),
            BADGE: verdict_badge(results.verdict),
        },
    )


_UNDER_GRID = "RMS of the evaluation table, and, if known, the largest error of a calibrated sensor."


def write_cells(results: PipelineResults, output: Path, jobs: int | None = None) -> None:
    """Write each cell's own results into the output folder, of many cells in several processes.

    Args:
        results: the cells.
        output: the folder.
        jobs: number of processes; None for one per core.

    Raises:
        InfrastructureError: a file cannot be written, or a process died.
    """
    cells = (*results.cells, *results.comparisons)
    count = min(jobs or cores(), -(-len(cells) // CELLS_A_PROCESS))
    shares = [partial(_write_cells, cells[number::count], output) for number in range(count)]
    run_tasks([Task.call(str(number), share) for number, share in enumerate(shares)], workers=count or None)


def _write_cells(cells: Sequence[CellResult], output: Path) -> None:
    """Write one after the other, as they are large."""
    for cell in cells:
        if cell.details and (file := own_file(cell)):
            write_atomically(output / file, results_text(cell.verdict, PipelineResults((cell,)), cell.all_reasons))


def _junit_suites(results: PipelineResults) -> dict[str, list[Outcome]]:
    def outcome(group: str, each: CellResult | Collected) -> Outcome:
        found = Outcome(name=each.name, group=group, reasons=each.reasons, error=each.error, seconds=each.seconds)
        if not isinstance(each, CellResult) or not each.undecided:
            return found
        reasons = tuple(f"undecided: {reason}" for reason in each.undecided)
        if each.passes:
            return replace(found, skipped="\n".join(reasons))
        return replace(found, reasons=(*found.reasons, *reasons), is_undecided=each.verdict == "undecided")

    suites = {s: [outcome(s, cell) for cell in results.cells if cell.system == s] for s in results.systems}
    collected = [outcome("collected", each) for each in results.collections]
    return suites | ({"collected": collected} if collected else {})
