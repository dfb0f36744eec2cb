"""Tables of the report on a pipeline's results.

The main table has noise pairs and other methods as rows, systems as columns.
"""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from calibration.base import rounded
from calibration.base.verdict import worst_verdict
from calibration.ci.report import VERDICTS, Table, count_of, shown
from calibration.engine.baseline.comparison import BaselineChange
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds, size_of_change
from calibration.pipeline.matrix.cell_result import (
    OUR_METHOD,
    CellResult,
    Details,
    Deviation,
    TransformResult,
    noise_text,
)
from calibration.pipeline.results import Collected, PipelineResults

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
    details = best_details(results).get(system)
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
    details = best_details(results).get(system)
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
    first = best_details(results)
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
        for system, details in best_details(results).items()
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
        for system, details in best_details(results, converged=False).items()
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
    first = best_details(results)
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
    for system, details in best_details(results).items():
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
        for system, details in best_details(results).items()
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


def best_details(results: PipelineResults, converged: bool = True) -> dict[str, Details]:
    """Return the details of each system's best cell, the first with the best verdict, by default of the converged."""
    best = _best_cells(results, converged)
    return {system: cell.details for system, cell in best.items() if cell.details}


def _best_cells(results: PipelineResults, converged: bool = True) -> dict[str, CellResult]:
    """Return those cells."""
    cells = [cell for cell in (*results.cells, *results.comparisons) if cell.details and cell.converged >= converged]
    best_first = sorted(cells, key=lambda cell: VERDICTS.index(cell.verdict))
    best = {cell.system: cell for cell in reversed(best_first)}
    return {system: best[system] for system in results.systems if system in best}
