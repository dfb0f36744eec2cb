"""Blocks of the report on a pipeline's results: tables, and messages of one line each.

The main table has noise pairs and other methods as rows, systems as columns.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.base import rounded
from calibration.base.verdict import worst_verdict
from calibration.ci.report import VERDICTS, Table, count_of, shown
from calibration.engine.baseline.comparison import BaselineChange
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds, size_of_change
from calibration.engine.diagnosis.finding import Severity
from calibration.engine.evaluation.specification import FILES_WITHOUT_RMS
from calibration.pipeline.matrix.cell_result import (
    OUR_METHOD,
    REPROJECTION_FILE,
    CellResult,
    Details,
    Deviation,
    TransformResult,
    noise_text,
)
from calibration.pipeline.results import Collected, ImageResult, PipelineResults

NOT_CONVERGED = "it has not converged"
MAX_COLUMNS_IN_LOG = 3
"""Limit of the systems side by side in a log."""
PARAMETERS_SHOWN = 200
TRANSFORMS_SHOWN = 30
CAUSES_SHOWN = 3
SENSORS_IN_OVERVIEW = 3


def cells_table(results: PipelineResults) -> Table:
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


def overview_table(results: PipelineResults) -> Table:
    """Return a row for each system: verdict, error bars, errors of its cells, its tasks, and what has changed."""
    rows = []
    for system in results.systems:
        cells = [cell for cell in results.cells if cell.system == system]
        verdict = worst_verdict(cell.verdict for cell in cells)
        rms = [cell.rms_px for cell in cells if cell.rms_px is not None]
        row = (
            verdict if verdict == "pass" else verdict.upper(),
            _error_bars_in_brief(results, system),
            ", ".join(_largest_deviations([cell.truth for cell in cells if cell.truth])),
            f"{max(rms):.3g} px" if rms else "",
            _tasks_in_brief(results, system),
            _changes_in_brief(results, system),
        )
        rows.append((system, *row))
    header = ("Robot", "Verdict", "Error bars", "Against the truth", "RMS", "Tasks", "Since accepted")
    filled = [n for n, column in enumerate(zip(*rows, strict=True)) if any(column)]
    shown_rows = tuple(tuple(row[n] or "-" for n in filled) for row in rows)
    return Table(tuple(header[n] for n in filled), shown_rows, TRANSFORMS_SHOWN, brief=True, only="summary")


def _error_bars_in_brief(results: PipelineResults, system: str) -> str:
    """Describe the standard deviations of each sensor, worst first: "lidar3d ± 1.9 mm, 0.07 deg"; else the largest."""
    details = _best_details(results).get(system)
    poses = details.snapshot.poses if details and details.snapshot else ()
    sensors = details.recording.sensors if details and details.recording else ()
    sigmas = {
        each.name: np.sqrt(np.diag(each.covariance))
        for each in poses
        if each.covariance is not None and each.name in sensors
    }
    sizes = {
        name: (1e3 * float(np.linalg.norm(s[:3])), math.degrees(np.linalg.norm(s[3:]))) for name, s in sigmas.items()
    }
    worst = sorted(sizes, key=lambda name: -sizes[name][0])
    texts = [f"{name} ± {sizes[name][0]:.2g} mm, {sizes[name][1]:.2g} deg" for name in worst[:SENSORS_IN_OVERVIEW]]
    texts += [f"{count_of(len(worst) - SENSORS_IN_OVERVIEW, 'better one')}"] * (len(worst) > SENSORS_IN_OVERVIEW)
    largest = _largest_deviations([cell.sigma for cell in results.cells if cell.system == system and cell.sigma])
    if texts:
        return "; ".join((*texts, *largest[2:]))
    return f"± {', '.join(largest)}" if largest else ""


def _tasks_in_brief(results: PipelineResults, system: str) -> str:
    cell = _best_cells(results).get(system)
    states = Counter(task.state or "without a limit" for task in cell.tasks) if cell else Counter[str]()
    broken = states.pop("broken", 0)
    parts = [f"FAIL: {broken} broken"] if broken else []
    return ", ".join((*parts, *(f"{number} {state}" for state, number in states.items())))


def _changes_in_brief(results: PipelineResults, system: str) -> str:
    """Describe what has changed since the accepted calibration; empty if there is none."""
    details = _best_details(results).get(system)
    if details is None or not details.changes:
        return ""
    changed = [each for each in details.changes if exceeds(each, SameData())]
    if not changed:
        return "unchanged"
    most = max(changed, key=lambda change: change.sigmas or 0.0)
    more = f", and {count_of(len(changed) - 1, 'more change')}" if len(changed) > 1 else ""
    return f"{most.name} {size_of_change(most)}{more}"


def grid(results: PipelineResults) -> Table:
    """Return RMS and truth error, for each noise pair and each other method (rows) and system (columns).

    A system that the team's software calibrates has a second column: our engine on the same data and initial guesses.
    """
    rows: dict[str, dict[str, list[CellResult]]] = {}
    software = {cell.system for cell in results.cells if cell.method != OUR_METHOD}

    def column(cell: CellResult) -> str:
        if cell.system not in software:
            return cell.system
        return f"{cell.system}: {OUR_METHOD if cell.by_other_method else cell.method}"

    place = {system: n for n, system in enumerate(results.systems)}
    everything = sorted((*results.cells, *results.comparisons), key=lambda cell: place[cell.system])
    columns = list(dict.fromkeys(map(column, everything)))
    for cell in (*results.cells, *results.comparisons):
        rows.setdefault(_row_of_cell(cell), {}).setdefault(column(cell), []).append(cell)
    return Table(
        ("Start", *columns),
        tuple(
            (row, *(_worst_of_seeds(cells_of_row.get(column, ())) for column in columns))
            for row, cells_of_row in rows.items()
        ),
        most_columns=MAX_COLUMNS_IN_LOG,
    )


def _row_of_cell(cell: CellResult) -> str:
    if cell.translation_noise is None or cell.rotation_noise is None:
        return cell.method
    start = noise_text(cell.translation_noise, cell.rotation_noise)
    return f"{cell.method}, {start}" if cell.by_other_method else start


def _worst_of_seeds(cells: Sequence[CellResult]) -> str:
    """Format the worst of the seeds: "0.6004 px, 0.42 mm, 0.028 deg"; with the number that passed, if not all did."""
    if not cells:
        return "-"
    parts = []
    rms = [cell.rms_px for cell in cells if cell.rms_px is not None]
    if rms:
        parts.append(f"{max(rms):.4f} px")
    if poses := _largest_deviations([cell.poses for cell in cells if cell.poses is not None]):
        parts.append(f"poses off by {', '.join(poses)}")
    parts += _largest_deviations([cell.truth for cell in cells if cell.truth is not None])
    passed = sum(cell.verdict == "pass" for cell in cells)
    if cells[0].by_other_method:
        return ", ".join(parts) or "no result"
    if passed < len(cells):
        word = "FAIL" if any(cell.verdict == "fail" for cell in cells) else "UNDECIDED"
        parts.append(word if len(cells) == 1 else f"{word}: {passed}/{len(cells)} pass")
    elif len(cells) > 1:
        parts.append(f"{passed}/{len(cells)} pass")
    return ", ".join(parts) or "no result"


def truth_table(results: PipelineResults) -> Table:
    """Return a row for each system with a known truth: its cells' largest error, and their standard deviations."""
    rows = []
    for system in results.systems:
        cells = [cell for cell in results.cells if cell.system == system]
        truths, sigmas = [c.truth for c in cells if c.truth], [c.sigma for c in cells if c.sigma]
        if truths and sigmas:
            rows.append((system, ", ".join(_largest_deviations(truths)), ", ".join(_largest_deviations(sigmas))))
    return Table(("Against the truth", "Worst error", "Standard deviation stated"), tuple(rows))


def precision_table(results: PipelineResults) -> Table:
    """Return a row for each system without a truth: standard deviations, in total and by the labels' noise alone."""
    rows = []
    for system in results.systems:
        cells = [cell for cell in results.cells if cell.system == system and cell.truth is None]
        sigmas, alone = [c.sigma for c in cells if c.sigma], [c.label_sigma for c in cells if c.label_sigma]
        if sigmas and alone:
            rows.append((system, ", ".join(_largest_deviations(sigmas)), ", ".join(_largest_deviations(alone))))
    return Table(("How sure", "Standard deviation in all", "By the labels' noise alone"), tuple(rows))


def tasks_table(results: PipelineResults) -> Table:
    """Return a row for each task of each system's best cell: its error at the worst point, and what it comes from."""
    rows = []
    for system, cell in _best_cells(results).items():
        for task in cell.tasks:
            parts = ", ".join(f"{each.source} {each.sigma:.2g}" for each in task.parts[:CAUSES_SHOWN])
            limit = "-" if task.limit is None else f"{task.limit:.3g} {task.unit}: {task.state}"
            error = f"{task.median:.3g}, {task.most:.3g} {task.unit}"
            if task.truth is not None and task.within is not None:
                error += f"; true {task.truth:.3g} at most, {task.within:.0%} within"
            rows.append((f"{system}: {task.name}", error, task.worst, parts, limit))
    header = ("Task", "Error at the worst point: median, 95 %", "Worst point", "What it comes from", "Limit")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def _largest_deviations(deviations: Sequence[Deviation]) -> list[str]:
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


def collections_table(results: PipelineResults) -> Table:
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


def transforms_table(results: PipelineResults) -> Table:
    """Return a row for each calibrated transform of each system's best cell, with standard deviations."""
    first = _best_details(results)
    rows = [
        (
            f"{system}: {transform.parent} to {transform.child}",
            _vector_text(transform.trans, transform.sigma_trans, 1e3, 2),
            _vector_text(transform.rpy, transform.sigma_rpy, 180 / math.pi, 3),
            _distance_text(transform),
        )
        for system in results.systems
        if (details := first.get(system))
        for transform in details.transforms
        if transform.rpy
    ]
    return Table(
        ("Calibrated", "x, y, z (mm)", "roll, pitch, yaw (deg)", "From the description"),
        tuple(rows),
        TRANSFORMS_SHOWN,
        brief=True,
    )


def hangs_on_table(results: PipelineResults) -> Table:
    """Return a row for each system: the fixed parameters whose usual uncertainty makes most of the error bars."""
    rows = [
        (system, ", ".join(f"{share.cause} {share.mm:.2g} mm" for share in details.hangs_on[:CAUSES_SHOWN]))
        for system, details in _best_details(results).items()
        if details.hangs_on
    ]
    return Table(("What the result hangs on", "What the usual uncertainty of each is worth"), tuple(rows))


def recordings_table(results: PipelineResults) -> Table:
    """Return a row for each system: what was calibrated."""
    rows = [
        (
            system,
            recording.dataset,
            "; ".join(recording.patterns),
            str(recording.collections),
            ", ".join(recording.sensors),
        )
        for system, details in _best_details(results, converged=False).items()
        if (recording := details.recording)
    ]
    return Table(("Robot", "Dataset", "Pattern", "Collections", "Sensors"), tuple(rows), brief=True, only="summary")


def _vector_text(values: Sequence[float], sigmas: Sequence[float] | None, factor: float, digits: int) -> str:
    """Format three numbers with the norm of their standard deviations: "10.00, -3.25, 0.40 ± 0.023"."""
    text = ", ".join(f"{round(factor * value, digits) + 0.0:.{digits}f}" for value in values)  # no -0.00
    return text if sigmas is None else f"{text} ± {rounded(factor * math.hypot(*sigmas), 2)}"


def _distance_text(transform: TransformResult) -> str:
    """Describe its distance from the robot's description, or that it was fixed."""
    if transform.sigma_trans is None:
        return "held"
    if transform.moved_mm is None:
        return "-"
    return f"{transform.moved_mm:.3g} mm, {transform.moved_deg:.2g} deg"


def parameters_table(results: PipelineResults) -> Table:
    """Return a row for each calibrated parameter of a joint or a camera, of each system's best cell."""
    first = _best_details(results)
    rows: list[tuple[str, ...]] = [
        (
            system,
            parameter.name,
            parameter.parameter,
            f"{parameter.value:.6g}",
            "-" if parameter.sigma is None else f"{parameter.sigma:.2g}",
            parameter.unit,
        )
        for system in results.systems
        if (details := first.get(system))
        for parameter in (*details.joints, *details.lags, *details.intrinsics)
    ]
    return Table(
        ("System", "Joint or camera", "Parameter", "Value", "Sigma", "Unit"),
        tuple(rows),
        PARAMETERS_SHOWN,
        title="Joints and intrinsics",
        only="summary",
    )


def cameras_table(results: PipelineResults) -> Table:
    """Return a row for each camera with calibrated intrinsics, of each system's best cell."""
    rows = []
    for system, details in _best_details(results).items():
        for camera in (each for each in details.projection if each.given is None):
            parameters = {row.parameter: row for row in details.intrinsics if row.name == camera.camera}
            focal, centre = (
                ", ".join(
                    f"{parameters[p].value:.2f} ± {parameters[p].sigma or 0:.2g}" for p in names if p in parameters
                )
                or "held"
                for names in (("fx", "fy"), ("cx", "cy"))
            )
            off = f"{camera.median_px:.2g} ({camera.worst_px:.2g}) at {camera.distance_m:.2g} m, "
            off += f"{camera.far_median_px:.2g} ({camera.far_worst_px:.2g}) far away"
            rows.append((f"{system}: {camera.camera}", camera.model, focal, centre, off))
    header = ("Camera", "Lens", "fx, fy (px)", "cx, cy (px)", "Projection ± median (worst), px")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def changes_table(results: PipelineResults) -> Table:
    """Return a row for each calibrated transform or parameter that differs from the accepted one, beyond rounding."""
    rows = [
        (f"{system}: {change.name}", _change_text(change), _in_sigmas(change))
        for system, details in _best_details(results).items()
        for change in details.changes
        if exceeds(change, SameData())
    ]
    header = ("Since the baseline", "Difference", "In standard deviations")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def updates_table(results: PipelineResults) -> Table:
    """Return a row for each number of the baseline that the change under test replaces."""
    rows = [
        (
            f"{update.system}: {update.change.name}" if update.change else update.system,
            update.before or "-",
            update.now or "-",
            f"{_change_text(update.change)}, {_in_sigmas(update.change)} sigma" if update.change else "-",
            update.although or "-",
        )
        for update in (results.baseline.updates if results.baseline else ())
    ]
    header = ("Accepted by this change", "Before", "Now", "Difference", "Although it failed")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def _change_text(change: BaselineChange) -> str:
    if change.kind != "pose":
        return change.kind if change.value is None else f"{change.value:+.3g} {change.unit}"
    return (
        f"{change.mm:.3g} ± {change.sigma_mm:.2g} mm"
        f"{_direction_text(change.translation_mm, 2) if change.mm > change.sigma_mm else ''}, "
        f"{change.deg:.2g} ± {change.sigma_deg:.1g} deg"
        f"{_direction_text(change.rotation_deg, 3) if change.deg > change.sigma_deg else ''}"
    )


def _direction_text(vector: Sequence[float], digits: int) -> str:
    return f" ({_vector_text(vector, None, 1.0, digits)})"


def _in_sigmas(change: BaselineChange) -> str:
    return f"{change.sigmas:.2g}" if change.sigmas < 1e6 else "-"


def _best_details(results: PipelineResults, converged: bool = True) -> dict[str, Details]:
    """Return the details of each system's best cell, the first with the best verdict, by default of the converged."""
    best = _best_cells(results, converged)
    return {system: cell.details for system, cell in best.items() if cell.details}


def _best_cells(results: PipelineResults, converged: bool = True) -> dict[str, CellResult]:
    """Return those cells."""
    cells = [cell for cell in (*results.cells, *results.comparisons) if cell.details and cell.converged >= converged]
    best_first = sorted(cells, key=lambda cell: VERDICTS.index(cell.verdict))
    best = {cell.system: cell for cell in reversed(best_first)}
    return {system: best[system] for system in results.systems if system in best}


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
    for system, details in _best_details(results).items():
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
