"""Report of a pipeline, whose main table has noise pairs and other methods as rows, systems as columns."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from calibration.baseline.comparison import Change
from calibration.baseline.update import BaselineUpdate
from calibration.diagnosis.finding import Severity
from calibration.execution.embedded import cores
from calibration.execution.tasks import Task, run_tasks
from calibration.files import write_atomically
from calibration.pipeline.matrix.cell import REPROJECTION, noise_text
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult, Details, Deviation, Transform
from calibration.pipeline.results import CELLS_FILE, Analysed, Collected, ImageResult, Results, own_file
from calibration.report import Lines, Outcome, Report, Table, Text, count_of, results_text, shown
from calibration.report.badge import FILE as BADGE
from calibration.report.badge import verdict_badge

REASONS_SHOWN = 4
NOTES_SHOWN = 30
SIDE_BY_SIDE = 3
"""Limit of the systems side by side in a log."""
PARAMETERS_SHOWN = 200
TRANSFORMS_SHOWN = 30
CELLS_A_PROCESS = 50
"""Least number of cells whose files a process writes: in less time than one takes to begin."""


def write_results(results: Results, output: Path) -> None:
    """Write the files of a stage's results into the output folder, for the next stage and for people.

    Raises:
        InfrastructureError: a file cannot be written.
    """
    write_cells(results, output, 1)
    report(results, output, "calibration").write(output)


def report(results: Results, output: Path, title: str) -> Report:
    """Return the report.

    Args:
        results: the results.
        output: the folder of the results.
        title: of the report and its annotations.
    """
    left_out = tuple(without_result(results))
    numbers = results.summary.all
    main = grid(results)
    return Report(
        title=title,
        verdict=results.verdict,
        error=results.exit_code,
        sentence=_sentence(results),
        reasons=(
            *failures(results),
            *(results.baseline.reasons if results.baseline else ()),
            *(reason for each in results.exports for reason in each.reasons),
            *(results.analysis.reasons if results.analysis else ()),
        ),
        warnings=(*_said(results, "warning"), *left_out),
        blocks=(
            main,
            Text(_UNDER_GRID if main.rows else "", only="summary"),
            Text(_without_table(results)),
            truth_table(results),
            precision_table(results),
            Lines(tuple(other_methods(results)), only="summary"),
            transforms_table(results),
            parameters_table(results),
            changes_table(results),
            updates_table(results),
            Text(_said_of_baseline(results.baseline)),
            collections_table(results),
            Lines(_said(results, "warning"), NOTES_SHOWN, title="To look at", only="summary"),
            Lines(_said(results, "note"), NOTES_SHOWN, title="Notes"),
            Lines(tuple(_exports(results, output)), NOTES_SHOWN, title="For the robot"),
            Text(f"{image_line(results.image)}." if results.image else ""),
            Text(f"Static analysis: {output / results.analysis.folder / 'summary.md'}" if results.analysis else ""),
            Lines(left_out, title="Methods without a result", only="summary"),
        ),
        suites=_suites(results),
        results=results.without_details,
        outputs={
            "output": output,
            "exports": "\n".join(str(output / each.folder) for each in results.exports if each.files),
            "success-rate": numbers.success_rate if results.judged else None,
            "worst-rms-px": numbers.worst_rms_px,
            "worst-translation-mm": numbers.worst_translation_mm,
        },
        files={CELLS_FILE: cells_table(results).csv(), BADGE: verdict_badge("calibration", results.verdict)},
    )


_UNDER_GRID = "RMS of the evaluation table, and, if known, the largest error of a calibrated sensor."


def _without_table(results: Results) -> str:
    """Describe the RMS of cells without a table."""
    names = [cell.system for cell in results.cells if cell.table and Path(cell.table).name == REPROJECTION]
    if not names:
        return ""
    which = f"RMS of {', '.join(dict.fromkeys(names))}: of all corners against where the calibration puts them"
    return f"{which}; a table between two sensors is another number: evaluate: rgb-to-rgb:SOURCE:TARGET"


def write_cells(results: Results, output: Path, jobs: int | None = None) -> None:
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
            write_atomically(output / file, results_text(cell.verdict, Results((cell,)), cell.reasons))


def _suites(results: Results) -> dict[str, list[Outcome]]:
    def outcome(group: str, each: CellResult | Collected) -> Outcome:
        return Outcome(name=each.name, group=group, reasons=each.reasons, error=each.error, seconds=each.seconds)

    suites = {s: [outcome(s, cell) for cell in results.cells if cell.system == s] for s in results.systems}
    collected = [outcome("collected", each) for each in results.collections]
    return suites | ({"collected": collected} if collected else {})


def cells_table(results: Results) -> Table:
    """Return a row for each cell and comparison, for ``cells.csv``: for introspect-csv, a spreadsheet or a plot."""

    def row(cell: CellResult) -> tuple[str, ...]:
        noise = (cell.translation_noise, cell.rotation_noise, cell.seed)
        verdict = "" if cell.by_other_method else cell.verdict
        truth = (cell.truth.translation_mm, cell.truth.rotation_deg) if cell.truth else (None, None)
        numbers = ((cell.rms_px, ".4f"), (truth[0], ".4f"), (truth[1], ".5f"))
        return (
            *(cell.name, cell.system, cell.method),
            *(shown(value, "g", empty="") for value in noise),
            *(verdict, *(shown(value, form, empty="") for value, form in numbers)),
        )

    header = ("Cell", "System", "Method", "Translation noise (m)", "Rotation noise (rad)", "Seed", "Verdict")
    rows = tuple(map(row, (*results.cells, *results.comparisons)))
    return Table((*header, "RMS (pix)", "Trans error (mm)", "Rot error (deg)"), rows)


def grid(results: Results) -> Table:
    """Return RMS and truth error, for each noise pair and each other method (rows) and system (columns).

    A system that the team's software calibrates has a second column: our engine on the same data and initial guesses.
    """
    rows: dict[str, dict[str, list[CellResult]]] = {}
    software = {cell.system for cell in results.cells if cell.method != OUR_METHOD}

    def column(cell: CellResult) -> str:
        if cell.system not in software:
            return cell.system
        return f"{cell.system}: {OUR_METHOD if cell.by_other_method else cell.method}"

    everything = sorted((*results.cells, *results.comparisons), key=lambda c: results.systems.index(c.system))
    columns = list(dict.fromkeys(map(column, everything)))
    for cell in (*results.cells, *results.comparisons):
        rows.setdefault(_row(cell), {}).setdefault(column(cell), []).append(cell)
    return Table(
        ("Start", *columns),
        tuple((row, *(_text(found.get(column, ())) for column in columns)) for row, found in rows.items()),
        most_columns=SIDE_BY_SIDE,
        brief=True,
    )


def _row(cell: CellResult) -> str:
    if cell.translation_noise is None or cell.rotation_noise is None:
        return cell.method
    start = noise_text(cell.translation_noise, cell.rotation_noise)
    return f"{cell.method}, {start}" if cell.by_other_method else start


def truth_table(results: Results) -> Table:
    """Return a row for each system with a known truth: its cells' largest error, and their standard deviations."""
    rows = []
    for system in results.systems:
        own = [cell for cell in results.cells if cell.system == system]
        truths, sigmas = [c.truth for c in own if c.truth], [c.sigma for c in own if c.sigma]
        if truths and sigmas:
            rows.append((system, ", ".join(_worst(truths)), ", ".join(_worst(sigmas))))
    return Table(("Against the truth", "Worst error", "Standard deviation stated"), tuple(rows))


def precision_table(results: Results) -> Table:
    """Return a row for each system without a truth: standard deviations, in total and by the labels' noise alone."""
    rows = []
    for system in results.systems:
        own = [cell for cell in results.cells if cell.system == system and cell.truth is None]
        sigmas, alone = [c.sigma for c in own if c.sigma], [c.label_sigma for c in own if c.label_sigma]
        if sigmas and alone:
            rows.append((system, ", ".join(_worst(sigmas)), ", ".join(_worst(alone))))
    return Table(("How sure", "Standard deviation in all", "By the labels' noise alone"), tuple(rows))


def _text(cells: Sequence[CellResult]) -> str:
    """Format the worst of the seeds: "0.6004 px, 0.42 mm, 0.028 deg"; with the number that passed, if not all did."""
    if not cells:
        return "-"
    parts = []
    rms = [cell.rms_px for cell in cells if cell.rms_px is not None]
    if rms:
        parts.append(f"{max(rms):.4f} px")
    if poses := _worst([cell.poses for cell in cells if cell.poses is not None]):
        parts.append(f"poses off by {', '.join(poses)}")
    parts += _worst([cell.truth for cell in cells if cell.truth is not None])
    passed = sum(cell.verdict == "pass" for cell in cells)
    if cells[0].by_other_method:
        return ", ".join(parts) or "no result"
    if passed < len(cells):
        parts.append("FAIL" if len(cells) == 1 else f"FAIL: {passed}/{len(cells)} pass")
    elif len(cells) > 1:
        parts.append(f"{passed}/{len(cells)} pass")
    return ", ".join(parts) or "no result"


def _worst(deviations: Sequence[Deviation]) -> list[str]:
    """Format the largest of each kind: "0.42 mm", "0.028 deg", "joints 0.01 mm, 0.002 deg"; empty if there are none."""
    if not deviations:
        return []
    lengths = [d.joint_mm for d in deviations if d.joint_mm is not None]
    angles = [d.joint_deg for d in deviations if d.joint_deg is not None]
    joints = [f"{max(lengths):.2g} mm"] if lengths else []
    joints += [f"{max(angles):.2g} deg"] if angles else []
    return [
        f"{max(d.translation_mm for d in deviations):.3g} mm",
        f"{max(d.rotation_deg for d in deviations):.2g} deg",
        *([f"joints {', '.join(joints)}"] if joints else []),
    ]


def collections_table(results: Results) -> Table:
    """Return a row for each collected dataset: kept collections, errors of corners and sensors."""

    def row(c: Collected) -> tuple[str, ...]:
        truth = [
            shown(value, form, unit)
            for value, form, unit in ((c.translation_mm, ".3g", "mm"), (c.rotation_deg, ".2g", "deg"))
            if value is not None
        ]
        verdict = [] if c.verdict == "pass" else ["FAIL"]
        return (
            c.name,
            f"{c.kept} of {c.poses} poses",
            shown(c.corner_rms_px, ".3f", "px"),
            shown(c.rms_px, ".4f", "px"),
            ", ".join((*truth, *verdict)) or "-",
        )

    return Table(
        ("Collected", "Kept", "Corner error", "Calibrates with", "Against the truth"),
        tuple(row(collected) for collected in results.collections),
        title="Collected in simulation",
    )


def transforms_table(results: Results) -> Table:
    """Return a row for each calibrated transform of each system's first cell that passed, with standard deviations."""
    first = _details(results)
    rows = [
        (
            f"{system}: {each.parent} to {each.child}",
            _vector(each.trans, each.sigma_trans, 1e3, 2),
            _vector(each.rpy, each.sigma_rpy, 180 / math.pi, 3),
            _moved(each),
        )
        for system in results.systems
        if (found := first.get(system))
        for each in found.transforms
        if each.rpy
    ]
    return Table(
        ("Calibrated", "x, y, z (mm)", "roll, pitch, yaw (deg)", "From the description"),
        tuple(rows),
        TRANSFORMS_SHOWN,
    )


def _vector(values: Sequence[float], sigmas: Sequence[float] | None, factor: float, digits: int) -> str:
    """Format three numbers with the norm of their standard deviations: "10.00, -3.25, 0.40 +- 0.023"."""
    text = ", ".join(f"{round(factor * value, digits) + 0.0:.{digits}f}" for value in values)  # no -0.00
    return text if sigmas is None else f"{text} +- {factor * math.hypot(*sigmas):.2g}"


def _moved(transform: Transform) -> str:
    """Describe its distance from the robot's description, or that it was fixed."""
    if transform.sigma_trans is None:
        return "held"
    if transform.moved_mm is None:
        return "-"
    return f"{transform.moved_mm:.3g} mm, {transform.moved_deg:.2g} deg"


def _details(results: Results, failed: bool = False) -> dict[str, Details]:
    """Return the details of each system's first cell that passed, or that may have failed."""
    passed = [cell for cell in (*results.cells, *results.comparisons) if failed or cell.verdict == "pass"]
    return {cell.system: cell.details for cell in reversed(passed) if cell.details}


def changes_table(results: Results) -> Table:
    """Return a row for each calibrated transform or parameter: its difference from the accepted one."""
    rows = [
        (f"{system}: {each.name}", _change(each), _in_sigmas(each))
        for system, found in _details(results, failed=True).items()
        for each in found.changes
        if each.kind in ("pose", "parameter") and (each.mm or each.deg or each.value)
    ]
    header = ("Since the baseline", "Difference", "In standard deviations")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def updates_table(results: Results) -> Table:
    """Return a row for each number of the baseline that the change under test replaces."""
    rows = [
        (
            f"{each.system}: {each.change.name}" if each.change else each.system,
            each.before or "-",
            each.now or "-",
            f"{_change(each.change)}, {_in_sigmas(each.change)} sigma" if each.change else "-",
            each.although or "-",
        )
        for each in (results.baseline.updates if results.baseline else ())
    ]
    header = ("Accepted by this change", "Before", "Now", "Difference", "Although it failed")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def _change(change: Change) -> str:
    if change.kind != "pose":
        return change.kind if change.value is None else f"{change.value:+.3g} {change.unit}"
    return (
        f"{change.mm:.3g} +- {change.sigma_mm:.2g} mm ({_vector(change.translation_mm, None, 1.0, 2)}), "
        f"{change.deg:.2g} +- {change.sigma_deg:.1g} deg ({_vector(change.rotation_deg, None, 1.0, 3)})"
    )


def _in_sigmas(change: Change) -> str:
    return f"{change.sigmas:.2g}" if change.sigmas < 1e6 else "-"


def _said_of_baseline(update: BaselineUpdate | None) -> str:
    """Describe the systems compared with the baseline, and remarks on it."""
    if update is None:
        return ""
    parts = [f"Compared with {update.since}: {', '.join(update.compared)}"] if update.compared else []
    if update.not_accepted:
        parts.append(f"no calibration accepted yet of {', '.join(update.not_accepted)}: calibration accept")
    parts += [update.problem] if update.problem and not update.reasons else []
    if update.unused:
        parts.append(f"{update.file} has systems that are calibrated no more: {', '.join(update.unused)}")
    return "; ".join(parts)


def parameters_table(results: Results) -> Table:
    """Return a row for each calibrated parameter of a joint or a camera, of each system's first cell that passed."""
    first = _details(results)
    rows: list[tuple[str, ...]] = [
        (
            system,
            each.name,
            each.parameter,
            f"{each.value:.6g}",
            "-" if each.sigma is None else f"{each.sigma:.2g}",
            each.unit,
        )
        for system in results.systems
        if (found := first.get(system))
        for each in (*found.joints, *found.intrinsics)
    ]
    return Table(
        ("System", "Joint or camera", "Parameter", "Value", "Sigma", "Unit"),
        tuple(rows),
        PARAMETERS_SHOWN,
        title="Joints and intrinsics",
        only="summary",
    )


def _sentence(results: Results) -> str:
    """Return the verdict in one line."""
    done, failed = [], []
    for things, what, verb in ((results.cells, "cell", "calibrated"), (results.collections, "dataset", "collected")):
        wrong = sum(thing.verdict == "fail" for thing in things)
        count = count_of(len(things), what)
        nothing = not results.judged and results.image is None and results.analysis is None
        if wrong or (what == "cell" and nothing):
            failed.append(f"{wrong} of {count} failed")
        elif things:
            done.append(f"{count} {verb}")
    if results.image is not None and not results.judged:
        done.append("the image is built" if results.image.built else "the image is there")
    if results.analysis is not None:
        done.append(_analysis_sentence(results.analysis))
    return ", ".join((*failed, *done))


def _analysis_sentence(analysis: Analysed) -> str:
    count = count_of(analysis.findings, "finding")
    return f"{count} in the code" if analysis.new is None else f"{count} in the code, {analysis.new} new"


def failures(results: Results) -> list[str]:
    """Return a line for everything that failed, with its first reasons; results.json has all of them.

    Equal reasons of several cells of a system are merged into one line.
    """
    references = {cell.start_of_cell: cell for cell in results.comparisons if not cell.by_other_method}
    alike: dict[tuple[str, str], list[CellResult]] = {}
    for cell in results.cells:
        if cell.verdict == "fail":
            why = f"{_first(cell.reasons)}{_whose_fault(cell, references.get(cell.start_of_cell))}"
            alike.setdefault((cell.system, why), []).append(cell)
    starts = Counter(cell.system for cell in results.cells)
    cells = [f"{_names(each, starts[system])}: {why}" for (system, why), each in alike.items()]
    return cells + [f"collected {c.name}: {_first(c.reasons)}" for c in results.collections if c.verdict == "fail"]


def _names(alike: Sequence[CellResult], starts: int) -> str:
    """Describe cells of a system with the same reasons."""
    first, more = alike[0], len(alike) - 1
    if more == 0:
        return first.name
    if len(alike) == starts:
        return f"{first.system}, all {starts} starts"
    return f"{first.name}, and {count_of(more, 'more start')}"


def _whose_fault(cell: CellResult, reference: CellResult | None) -> str:
    """Describe our engine's result, on the same data and initial guess, for a failed cell of the team's software."""
    if reference is None or cell.error is not None:  # a failure of the container engine is not the software's fault
        return ""
    if reference.verdict == "pass":
        rms = "" if reference.rms_px is None else f" ({reference.rms_px:.4f} px)"
        return f". Our engine passes on the same data from the same start{rms}: look at the software"
    return f". Our engine fails on the same data too ({_first(reference.reasons)}): look at the data"


def _first(reasons: Sequence[str]) -> str:
    more = len(reasons) - REASONS_SHOWN
    return "; ".join(reasons[:REASONS_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def without_result(results: Results) -> list[str]:
    """Return the reasons why other methods have no result, once for all cells; without our engine as a reference."""
    return list(
        dict.fromkeys(
            f"{cell.system}, {cell.method}: {'; '.join(cell.reasons)}"
            for cell in results.comparisons
            if cell.reasons and cell.by_other_method
        )
    )


def other_methods(results: Results) -> list[str]:
    """Return the implementation used by each of the other methods, and the data if there is a choice."""
    found: dict[str, dict[str, None]] = {}
    for cell in results.comparisons:
        if cell.detail is not None:
            found.setdefault(f"{cell.system}: {cell.detail}", {})[cell.method] = None
    return [f"{', '.join(methods)} on {detail}" for detail, methods in found.items()]


def image_line(image: ImageResult) -> str:
    """Describe the actions on the image."""
    what = f"built in {image.seconds:.0f} s" if image.built else "unchanged, nothing was built"
    promoted = f"; promoted to {', '.join(image.promoted)}" if image.promoted else ""
    return f"Image {image.reference}: {what}{promoted}"


def _exports(results: Results, output: Path) -> Iterator[str]:
    for each in results.exports:
        if each.files:
            yield f"{output / each.folder}: {', '.join(each.files)}"
        yield from (f"{each.system}: {note}" for note in each.notes)


def _said(results: Results, severity: Severity) -> tuple[str, ...]:
    """Return the findings of one severity, once per system."""
    said = (f"{c.system}: {found.text}" for c in results.cells for found in c.findings if found.severity == severity)
    return tuple(dict.fromkeys(said))
