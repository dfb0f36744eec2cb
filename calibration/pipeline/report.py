"""Report of a pipeline: its verdict, tables and messages of one line each together, and its files."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from calibration.base import write_atomically
from calibration.ci.execution.tasks import Task, cores, run_tasks
from calibration.ci.report import Lines, Outcome, Report, Text, count_of, results_text
from calibration.ci.report.blocks import BADGE_FILE as BADGE
from calibration.ci.report.blocks import verdict_badge
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds
from calibration.engine.diagnosis.finding import Severity
from calibration.engine.evaluation.specification import FILES_WITHOUT_RMS
from calibration.pipeline import report_tables
from calibration.pipeline.matrix.cell_result import OUR_METHOD, REPROJECTION_FILE, CellResult
from calibration.pipeline.results import CELLS_FILE, Collected, ImageResult, PipelineResults, own_file

NOTES_SHOWN = 30
NOT_CONVERGED = "it has not converged"
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
    left_out = tuple(without_result(results))
    numbers = results.summary.all
    main = report_tables.grid(results)
    if len(results.cells) <= len(results.systems) and not results.comparisons:  # the overview has it
        main = replace(main, only="log")
    return Report(
        title="Calibration",
        verdict=results.verdict,
        error=results.exit_code,
        sentence=verdict_sentence(results),
        reasons=(
            *failures(results),
            *(results.baseline.reasons if results.baseline else ()),
            *(reason for each in results.exports for reason in each.reasons),
            *(reason for each in results.of_stages.all for reason in each.reasons),
        ),
        undecided=tuple(undecided_limits(results, results.systems)),
        about=f"Commit {results.commit}" if results.commit else "",
        warnings=(*findings_of(results, "warning"), *left_out),
        blocks=(
            report_tables.overview_table(results),
            report_tables.recordings_table(results),
            main,
            Text(_UNDER_GRID if main.rows and main.only is None else "", only="summary"),
            *map(Text, origin_of_rms(results)),
            replace(report_tables.truth_table(results), only="log"),
            report_tables.precision_table(results),
            report_tables.tasks_table(results),
            Lines(tuple(other_methods(results)), only="summary"),
            report_tables.transforms_table(results),
            report_tables.cameras_table(results),
            report_tables.hangs_on_table(results),
            report_tables.parameters_table(results),
            report_tables.changes_table(results),
            report_tables.updates_table(results),
            Text(baseline_line(results)),
            Lines(tuple(lines_of_comment(results)), only="comment", brief=True),
            report_tables.collections_table(results),
            Lines(tuple(what_to_record(results)), title="What to record next"),
            Lines(findings_of(results, "warning"), NOTES_SHOWN, title="To look at", only="summary"),
            Lines(findings_of(results, "note"), NOTES_SHOWN, title="Notes"),
            Lines(tuple(export_lines(results, output)), NOTES_SHOWN, title="For the robot"),
            Text(image_line(results.image) if results.image else ""),
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
            CELLS_FILE: report_tables.cells_table(results).csv(),
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


def verdict_sentence(results: PipelineResults) -> str:
    """Return the verdict in one line."""
    done, failed = [], []
    for things, what, verb in ((results.cells, "cell", "calibrated"), (results.collections, "dataset", "collected")):
        verdicts = Counter(thing.verdict for thing in things)
        count = count_of(len(things), what)
        nothing = not results.has_verdict and results.image is None
        counted = [(verdicts["fail"], "failed")] if verdicts["fail"] or (what == "cell" and nothing) else []
        counted += [(verdicts["undecided"], "undecided")] if verdicts["undecided"] else []
        if counted:
            (number, word), *more = counted
            failed += [f"{number} of {count} {word}", *(f"{number} {word}" for number, word in more)]
        elif things:
            done.append(f"{count} {verb}")
    if results.image is not None and not results.judged:
        done.append("the image is built" if results.image.built else "the image is there")
    done += [stage.sentence for stage in results.of_stages.all]
    return ", ".join((*failed, *done))


def failures(results: PipelineResults) -> list[str]:
    """Return the reasons of everything that failed, a line each, worst first."""
    collected = [f"collected {each.name}: {reason}" for each in results.collections for reason in each.reasons]
    return failures_of_cells(results, results.systems) + collected


def failures_of_cells(results: PipelineResults, systems: Collection[str]) -> list[str]:
    """Return the reasons of the cells of some systems that failed, a line each, worst first.

    Equal reasons of several cells of a system are merged into one line; cells are named if there are several in all.
    """
    references = {cell.start_of_cell: cell for cell in results.comparisons if not cell.by_other_method}
    lines = {
        # Whose fault it is follows the first reason: GitHub shows nine annotations of a step.
        cell.name: (*cell.reasons[:1], *_whose_fault(cell, references.get(cell.start_of_cell)), *cell.reasons[1:])
        or (NOT_CONVERGED,)
        for cell in results.cells
        if cell.verdict == "fail" and cell.system in systems
    }
    return _lines_of_cells(results.cells, lines)


def undecided_limits(results: PipelineResults, systems: Collection[str]) -> list[str]:
    """Return a line for every undecided limit of the cells of some systems, likewise."""
    lines = {
        cell.name: [f"undecided: {why}" for why in cell.undecided] for cell in results.cells if cell.system in systems
    }
    return _lines_of_cells(results.cells, lines)


def _lines_of_cells(cells: Sequence[CellResult], lines: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the lines of cells, given by the cells' names, each once; of several cells with their names in front."""
    alike: dict[tuple[str, str], list[CellResult]] = {}
    for cell in cells:
        for line in dict.fromkeys(lines.get(cell.name, ())):
            alike.setdefault((cell.system, line), []).append(cell)
    if len(cells) == 1:
        return [line for _, line in alike]
    starts = Counter(cell.system for cell in cells)
    return [f"{_names_of_cells(same, starts[system])}: {line}" for (system, line), same in alike.items()]


def _names_of_cells(alike: Sequence[CellResult], starts: int) -> str:
    """Describe the cells of a system that have a line in common."""
    first, more = alike[0], len(alike) - 1
    if starts == 1:
        return first.system
    if len(alike) == starts:
        return f"{first.system}, all {starts} starts"
    return first.name if more == 0 else f"{first.name}, and {count_of(more, 'more start')}"


def _whose_fault(cell: CellResult, reference: CellResult | None) -> tuple[str, ...]:
    """Describe our engine's result, on the same data and initial guess, for a failed cell of the team's software."""
    if reference is None or cell.error is not None:  # a failure of the container engine is not the software's fault
        return ()
    if reference.verdict != "fail":
        rms = "" if reference.rms_px is None else f" ({reference.rms_px:.4f} px)"
        return (f"our engine passes on the same data from the same start{rms}: look at the software",)
    why = next(iter(reference.reasons), NOT_CONVERGED)
    return (f"our engine fails on the same data too ({why}): look at the data",)


def findings_of(results: PipelineResults, severity: Severity) -> tuple[str, ...]:
    """Return the findings of one severity, once per system, with the system in front if there are several."""
    several = len({cell.system for cell in results.cells}) > 1
    texts = (
        f"{cell.system}: {finding.text}" if several else finding.text
        for cell in results.cells
        for finding in cell.uncontradicted_findings
        if finding.severity == severity
    )
    return tuple(dict.fromkeys(texts))


def origin_of_rms(results: PipelineResults) -> tuple[str, ...]:
    """Describe the RMS of cells without a table, or with a table that has none: that of the calibration."""
    names: dict[str, dict[str, None]] = {}
    for cell in results.cells:
        file = Path(cell.table).name if cell.table else ""
        has_default_table = file == REPROJECTION_FILE and not (cell.details and cell.details.of_cameras_alone)
        if has_default_table or (cell.rms_px is not None and cell.method == OUR_METHOD and file in FILES_WITHOUT_RMS):
            names.setdefault(file, {})[cell.system] = None
    which = "of all corners against where the calibration puts them"
    between = "a table between two sensors is another number: evaluate: rgb-to-rgb:SOURCE:TARGET"
    return tuple(
        f"RMS of {', '.join(systems)}: {which}; {between if file == REPROJECTION_FILE else f'{file} has none'}"
        for file, systems in names.items()
    )


def baseline_line(results: PipelineResults) -> str:
    """Describe the systems compared with the baseline, and remarks on it."""
    update = results.baseline
    if update is None:
        return ""
    compared = "Nothing has changed since" if _equals_baseline(results) else "Compared with"
    parts = [f"{compared} {update.since}: {', '.join(update.compared)}"] if update.compared else []
    if update.not_accepted:
        none = "no calibration accepted yet of" if parts else "No calibration accepted yet of"
        parts.append(f"{none} {', '.join(update.not_accepted)}: calibration accept")
    parts += [update.problem] if update.problem and not update.reasons else []
    if update.unused:
        parts.append(f"{update.file} has systems that are calibrated no more: {', '.join(update.unused)}")
    return "; ".join(parts)


def _equals_baseline(results: PipelineResults) -> bool:
    """Whether every calibration equals the accepted one within the tolerances of a result on the same data."""
    compared = results.baseline.compared if results.baseline else ()
    cells = [cell for cell in results.cells if cell.system in compared]
    return bool(cells) and all(_equals_accepted(cell) for cell in cells)


def _equals_accepted(cell: CellResult) -> bool:
    changes = cell.details.changes if cell.details else ()
    differs = any(each.kind in ("added", "removed") or exceeds(each, SameData()) for each in changes)
    named = any(each.kind in ("baseline", "baseline-quality") for each in cell.findings)
    return bool(changes) and not differs and not named


def lines_of_comment(results: PipelineResults) -> Iterator[str]:
    """Yield what a comment says beside its tables: the accepted calibration, findings, time."""
    if line := baseline_line(results):
        yield line
    warnings, notes = (findings_of(results, severity) for severity in ("warning", "note"))
    if warnings or notes:
        counted = f"Findings: {len(warnings)} to look at, {count_of(len(notes), 'note')}"
        yield f"{counted}: {warnings[0]}" if warnings else counted
    if results.cells:
        seconds = sum(cell.seconds for cell in results.cells)
        yield f"Time: {seconds:.1f} s of calibration in {count_of(len(results.cells), 'cell')}"


def without_result(results: PipelineResults) -> list[str]:
    """Return the reasons why other methods have no result, once for all cells; without our engine as a reference."""
    return list(
        dict.fromkeys(
            f"{cell.system}, {cell.method}: {'; '.join(cell.reasons)}"
            for cell in results.comparisons
            if cell.reasons and cell.by_other_method
        )
    )


def other_methods(results: PipelineResults) -> list[str]:
    """Return the implementation used by each of the other methods, and the data if there is a choice."""
    methods_by_detail: dict[str, dict[str, None]] = {}
    for cell in results.comparisons:
        if cell.detail is not None:
            methods_by_detail.setdefault(f"{cell.system}: {cell.detail}", {})[cell.method] = None
    return [f"{', '.join(methods)} on {detail}" for detail, methods in methods_by_detail.items()]


def what_to_record(results: PipelineResults) -> Iterator[str]:
    """Yield the poses to record next of each system with an undecided limit, and what they bring."""
    for system, details in report_tables.best_details(results).items():
        if details.next_poses is not None:
            yield from (f"{system}: {line}" for line in details.next_poses.lines)


def image_line(image: ImageResult) -> str:
    """Describe the actions on the image."""
    what = f"built in {image.seconds:.0f} s" if image.built else "unchanged, nothing was built"
    promoted = f"; promoted to {', '.join(image.promoted)}" if image.promoted else ""
    return f"Image {image.reference}: {what}{promoted}"


def export_lines(results: PipelineResults, output: Path) -> Iterator[str]:
    """Yield the files of each export, and notes on them."""
    for export in results.exports:
        if export.files:
            yield f"{output / export.folder}: {', '.join(export.files)}"
        yield from (f"{export.system}: {note}" for note in export.notes)
