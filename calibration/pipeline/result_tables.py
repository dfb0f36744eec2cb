"""Tables of a pipeline's results; the main one has noise pairs and other methods as rows, systems as columns."""

import math
from collections.abc import Sequence

from calibration.ci.report import VERDICTS, Table, shown
from calibration.engine.baseline.comparison import Change
from calibration.engine.baseline.settings import SameData
from calibration.engine.baseline.verdict import exceeds
from calibration.pipeline.matrix.cell import noise_text
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult, Details, Deviation, Transform
from calibration.pipeline.results import Collected, Results

SIDE_BY_SIDE = 3
"""Limit of the systems side by side in a log."""
PARAMETERS_SHOWN = 200
TRANSFORMS_SHOWN = 30
CAUSES_SHOWN = 3


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

    place = {system: n for n, system in enumerate(results.systems)}
    everything = sorted((*results.cells, *results.comparisons), key=lambda cell: place[cell.system])
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
        word = "FAIL" if any(cell.verdict == "fail" for cell in cells) else "UNDECIDED"
        parts.append(word if len(cells) == 1 else f"{word}: {passed}/{len(cells)} pass")
    elif len(cells) > 1:
        parts.append(f"{passed}/{len(cells)} pass")
    return ", ".join(parts) or "no result"


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
    """Return a row for each calibrated transform of each system's best cell, with standard deviations."""
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
        brief=True,
    )


def hangs_on_table(results: Results) -> Table:
    """Return a row for each system: the fixed parameters whose usual uncertainty makes most of the error bars."""
    rows = [
        (system, ", ".join(f"{each.cause} {each.mm:.2g} mm" for each in found.hangs_on[:CAUSES_SHOWN]))
        for system, found in _details(results).items()
        if found.hangs_on
    ]
    return Table(("What the result hangs on", "What the usual uncertainty of each is worth"), tuple(rows))


def recordings_table(results: Results) -> Table:
    """Return a row for each system: what was calibrated."""
    rows = [
        (system, of.dataset, "; ".join(of.patterns), str(of.collections), ", ".join(of.sensors))
        for system, found in _details(results, converged=False).items()
        if (of := found.recording)
    ]
    return Table(("Robot", "Dataset", "Pattern", "Collections", "Sensors"), tuple(rows), brief=True, only="summary")


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


def parameters_table(results: Results) -> Table:
    """Return a row for each calibrated parameter of a joint or a camera, of each system's best cell."""
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
        for each in (*found.joints, *found.lags, *found.intrinsics)
    ]
    return Table(
        ("System", "Joint or camera", "Parameter", "Value", "Sigma", "Unit"),
        tuple(rows),
        PARAMETERS_SHOWN,
        title="Joints and intrinsics",
        only="summary",
    )


def cameras_table(results: Results) -> Table:
    """Return a row for each camera with calibrated intrinsics, of each system's best cell."""
    rows = []
    for system, found in _details(results).items():
        for each in found.projection:
            own = {row.parameter: row for row in found.intrinsics if row.name == each.camera}
            focal, centre = (
                ", ".join(f"{own[p].value:.2f} +- {own[p].sigma or 0:.2g}" for p in names if p in own) or "held"
                for names in (("fx", "fy"), ("cx", "cy"))
            )
            off = f"{each.median_px:.2g} ({each.worst_px:.2g}) at {each.distance_m:.2g} m, "
            off += f"{each.far_median_px:.2g} ({each.far_worst_px:.2g}) far away"
            rows.append((f"{system}: {each.camera}", each.model, focal, centre, off))
    header = ("Camera", "Lens", "fx, fy (px)", "cx, cy (px)", "Projection +- median (worst), px")
    return Table(header, tuple(rows), TRANSFORMS_SHOWN, brief=True)


def changes_table(results: Results) -> Table:
    """Return a row for each calibrated transform or parameter that differs from the accepted one, beyond rounding."""
    rows = [
        (f"{system}: {each.name}", _change(each), _in_sigmas(each))
        for system, found in _details(results).items()
        for each in found.changes
        if exceeds(each, SameData())
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
        f"{change.mm:.3g} +- {change.sigma_mm:.2g} mm"
        f"{_direction(change.translation_mm, 2) if change.mm > change.sigma_mm else ''}, "
        f"{change.deg:.2g} +- {change.sigma_deg:.1g} deg"
        f"{_direction(change.rotation_deg, 3) if change.deg > change.sigma_deg else ''}"
    )


def _direction(vector: Sequence[float], digits: int) -> str:
    return f" ({_vector(vector, None, 1.0, digits)})"


def _in_sigmas(change: Change) -> str:
    return f"{change.sigmas:.2g}" if change.sigmas < 1e6 else "-"


def _details(results: Results, converged: bool = True) -> dict[str, Details]:
    """Return the details of each system's best cell, the first with the best verdict, by default of the converged."""
    cells = [cell for cell in (*results.cells, *results.comparisons) if cell.details and cell.converged >= converged]
    best_first = sorted(cells, key=lambda cell: VERDICTS.index(cell.verdict))
    found = {cell.system: cell.details for cell in reversed(best_first) if cell.details}
    return {system: found[system] for system in results.systems if system in found}
