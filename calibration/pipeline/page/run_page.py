"""Page of a run: its head, which a reader understands in seconds, the tables of all systems, then each system."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.base import CalibrationError
from calibration.ci.pages.charts import ellipses, heat_map, point_map, trend
from calibration.ci.pages.html import Html, bullets, element, figure, folded, join, page, section, table, verdict_line
from calibration.ci.report import VERDICTS, Report, Table, Verdict, count_of
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.evaluation.label_errors import Residuals
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse, retract
from calibration.pipeline import report_tables
from calibration.pipeline.matrix.cell_result import CellResult, TaskMap, TaskResult
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.page.in_space import in_space
from calibration.pipeline.page.label_residuals import (
    label_residuals,
    poses_in_images,
    projection_figures,
    residuals_by_sensor,
)
from calibration.pipeline.report import failures, failures_of_cells, undecided_limits, verdict_sentence
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.system import System

if TYPE_CHECKING:
    from calibration.pipeline.history import History

MAX_SECTION_CHARACTERS = 8_000_000
"""Limit of the sections of all systems together; some 60 000 are one system, and browsers are slow beyond 10 MB."""
MAX_COMMITS = 50
"""Limit of the shown accepted calibrations, newest first."""
POSE_COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")


def report_page(
    report: Report,
    results: PipelineResults,
    output: Path,
    matrix: Matrix | None = None,
    accepted: "History | None" = None,
    given: Mapping[str, Dataset] | None = None,
) -> str:
    """Return the page, a single file.

    Args:
        report: of the run: its verdict and its reasons.
        results: the results, with the cells' details.
        output: the folder with the cells' datasets.
        matrix: the calibrated matrix, if its datasets are available, for limits and given datasets.
        accepted: the accepted calibrations through the commits of the repository.
        given: the given datasets by system, as far as they have been read already.
    """
    shown = {system: cell for system in results.systems if (cell := _shown_cell(results, system)) is not None}
    systems = {system.name: system for system in matrix.systems} if matrix else {}
    several = len(shown) > 1
    verdicts = {name: _of_system(results, name).verdict for name in shown}

    def section_of(name: str) -> Html:
        own = _of_system(results, name)
        own_head = _verdict_of_system(own) if several else Html("")
        if len(own.cells) > 1:
            own_head = join([own_head, element("p", f"Shown: {shown[name].name}", class_="soft")])
        return _system_section(own, shown[name], own_head, output, systems.get(name), accepted, (given or {}).get(name))

    sections = _sections_within_limit(verdicts, section_of)
    in_sections = {*failures_of_cells(results, sections), *undecided_limits(results, sections)} if several else set()
    left_out = len(shown) - len(sections)
    robots = count_of(len(shown), "robot") if several else "".join(shown)
    title = f"Calibration of {robots}" if shown else "Calibration"
    tables = (
        overview_table(results, {name: _anchor_of_system(name) for name in sections}),
        *_tables_of(results, report_tables.updates_table, report_tables.recordings_table),
        *_tables_of(results, report_tables.collections_table),
        starts_table(results) if several else Html(""),
    )
    head = [
        element("h1", title, id_="top"),
        banner(report, verdicts),
        element("p", " · ".join(filter(None, (report.about, engine_of(results)))), class_="soft"),
        bullets(tuple(reason for reason in report.all_reasons if reason not in in_sections)),
        element("p", _reason_of_left_out(left_out, len(shown)), class_="soft") if left_out else Html(""),
        *tables,
    ]
    return page(f"{title}: {report.verdict}", [join(head), *sections.values()])


def _tables_of(results: PipelineResults, *makers: Callable[[PipelineResults], Table], own: str = "") -> Iterator[Html]:
    """Yield tables, without the beginning of their rows that the section's title says."""
    for make in makers:
        made = make(results)
        yield table(made.columns, [(row[0].removeprefix(own), *row[1:]) for row in made.rows])


def _sections_within_limit(verdicts: Mapping[str, Verdict], section_of: Callable[[str], Html]) -> dict[str, Html]:
    """Return the sections of as many systems as the page takes, in their order; those that failed come first in it."""
    made: dict[str, Html] = {}
    characters = 0
    for name in sorted(verdicts, key=lambda name: -VERDICTS.index(verdicts[name])):
        made[name] = section_of(name)
        characters += len(made[name])
        if characters > MAX_SECTION_CHARACTERS:
            break
    return {name: made[name] for name in verdicts if name in made}


def _of_system(results: PipelineResults, name: str) -> PipelineResults:
    """Return the cells of a system."""
    cells, comparisons = (
        tuple(cell for cell in all_of if cell.system == name) for all_of in (results.cells, results.comparisons)
    )
    return PipelineResults(cells, comparisons)


def _verdict_of_system(results: PipelineResults) -> Html:
    """Return the verdict of a system, and the reasons of its cells."""
    reasons = (*failures(results), *undecided_limits(results, results.systems))
    return join([verdict_line(results.verdict, verdict_sentence(results)), bullets(reasons)])


def _reason_of_left_out(left_out: int, systems: int) -> str:
    return (
        f"{left_out} of {systems} systems are in the tables only, as the page would be too large for a browser; "
        "systems that failed come first. Their results are in results.json."
    )


def _shown_cell(results: PipelineResults, system: str) -> CellResult | None:
    """Return the cell of our engine that is shown for a system: the first with the best verdict, best if converged."""
    cells = [cell for cell in (*results.cells, *results.comparisons) if cell.system == system and cell.details]
    return min(cells, key=lambda cell: (VERDICTS.index(cell.verdict), not cell.converged), default=None)


def _anchor_of_system(system: str) -> str:
    return "system-" + "".join(c if c.isascii() and c.isalnum() else f"-{ord(c):x}-" for c in system)


def _system_section(
    own: PipelineResults,
    cell: CellResult,
    head: Html,
    output: Path,
    system: System | None,
    accepted: "History | None",
    given: Dataset | None,
) -> Html:
    """Return the sections of one system, by one of its cells, below its verdict and reasons."""
    name = cell.system
    of_cell = PipelineResults((cell,))
    notes = tuple(each.text for each in cell.uncontradicted_findings if each.severity in ("warning", "note"))
    numbers = (report_tables.transforms_table, report_tables.tasks_table, report_tables.changes_table)
    others = (report_tables.cameras_table, report_tables.parameters_table, report_tables.hangs_on_table)
    content = [head, *_tables_of(of_cell, *numbers, *others, own=f"{name}: ")]
    if notes:
        title = "To look at" if cell.verdict == "fail" else "What speaks for it, and what to look at"
        content += [element("h3", title), bullets(notes)]
    starts = report_tables.grid(own)
    if len(starts.rows) > 1:
        content.append(folded("Each start, and other methods", table(starts.columns, starts.rows)))
    try:
        calibrated_from = system.dataset if system else None
        dataset = read_dataset(output / cell.dataset, given=calibrated_from) if cell.dataset else None
    except CalibrationError as error:  # from a job whose files were not kept
        content.append(element("p", f"No figures: {error}", class_="soft"))
    else:
        if dataset is None and cell.own_folder is not None:
            content.append(element("p", "No figures: the dataset is not kept (datasets: none).", class_="soft"))
        elif dataset is not None:
            levels = cell.details.noise_levels if cell.details else None
            given = given or _given_dataset(system)
            if cell.details and (found := cell.details.next_poses) and found.poses:
                content += [element("h3", "What to record next"), bullets(found.lines)]
                content.append(poses_in_images(found, dataset, given))
            by_sensor = residuals_by_sensor(dataset)
            content.append(sensors_table(dataset, by_sensor))
            content.append(in_space(dataset, given, _as_accepted(dataset, cell), by_sensor))
            content += label_residuals(dataset, by_sensor, levels, given)
    content += [*task_figures(cell.tasks, cell.details.task_maps if cell.details else ())]
    content += [*projection_figures(cell.details.projection if cell.details else ())]
    content += [*_error_bars(cell, system.limits if system else None), *_trend_figures(name, accepted)]
    content.append(element("p", element("a", "To the top", href="#top")))
    return section(name, *content, anchor=_anchor_of_system(name))


def _given_dataset(system: System | None) -> Dataset | None:
    """Return the given dataset, if it is available."""
    try:
        return read_dataset(system.dataset) if system else None
    except CalibrationError:
        return None


def _as_accepted(dataset: Dataset, cell: CellResult) -> Dataset | None:
    """Return the dataset with the accepted transforms; None if none of them differs."""
    details = cell.details
    edges = {pose.name: pose.edge for pose in details.snapshot.poses} if details and details.snapshot else {}
    accepted = {}
    for change in details.changes if details else ():
        edge = edges.get(change.name)
        if change.kind == "pose" and edge is not None and edge in dataset.transforms and exceeds(change, SameData()):
            twist = np.concatenate([1e-3 * np.array(change.translation_mm), np.radians(change.rotation_deg)])
            move = retract(np.eye(4), twist)
            accepted[edge] = dataset.transforms[edge] @ inverse(move)
    return dataset.with_transforms(accepted) if accepted else None


def _trend_figures(system: str, found: "History | None") -> Iterator[Html]:
    """Return the figures of a system's sensors over the accepted calibrations of the repository."""
    figures = [
        figure(
            trend(
                each.name,
                [f"{point.date} {point.commit[:7]} {point.subject}" for point in each.points],
                [math.hypot(*point.translation_mm) for point in each.points],
                [point.sigma_mm for point in each.points],
                "mm",
            ),
            f"{each.name}: how far it is from where it was accepted first, by commit.",
        )
        for each in (found.trends if found else ())
        if each.system == system and len(each.points) > 1 and any(point.translation_mm for point in each.points)
    ]
    if figures:
        yield element("h3", "Accepted calibrations")
        yield element("div", *figures, class_="figures")


def accepted_history(file: Path) -> "History | None":
    """Return the newest accepted calibrations of the repository; None if there are none, or they are unreadable."""
    from calibration.pipeline.history import history_of  # most runs have no baseline

    try:
        return history_of(file, (), None, MAX_COMMITS)
    except CalibrationError:
        return None


def _error_bars(cell: CellResult, limits: Limits | None) -> Iterator[Html]:
    snapshot = cell.details.snapshot if cell.details else None
    figures = [
        figure(
            ellipses(pose.name, 1e6 * covariance[:3, :3], limits.translation_mm if limits else None),
            f"{pose.name}: two standard deviations of where it is, along its axes.",
        )
        for pose in (snapshot.poses if snapshot else ())
        if (covariance := pose.covariance) is not None
    ]
    correlations = [
        figure(
            heat_map(
                f"Correlations of {pose.name}",
                POSE_COORDINATES,
                POSE_COORDINATES,
                np.abs(covariance) / np.outer(sigmas, sigmas),
                "",
            ),
            f"{pose.name}: how its six errors hang together (0 to 1, turns in its own frame).",
        )
        for pose in (snapshot.poses if snapshot else ())
        if (covariance := pose.covariance) is not None and (sigmas := np.sqrt(np.diag(covariance))).all()
    ]
    if figures:
        yield element("h3", "How sure")
        weak = cell.details.weak_directions if cell.details else ()
        yield bullets(tuple(f"weakly determined: {each}" for each in weak))
        yield element("div", *figures, class_="figures")
        yield folded("Correlations", element("div", *correlations, class_="figures"))


NAMES_IN_BANNER = 5
COVERED_COLUMNS, COVERED_ROWS = 10, 8
"""Cells of an image; it is covered by those in which corners were seen."""


def banner(report: Report, verdicts: Mapping[str, Verdict]) -> Html:
    """Return the verdict in one sentence, in its colour.

    Args:
        report: of the run.
        verdicts: of its systems.
    """
    named = {word: [name for name, verdict in verdicts.items() if verdict == word] for word in ("fail", "undecided")}
    parts = []
    for names, one, more in ((named["fail"], "fails", "fail"), (named["undecided"], "is undecided", "are undecided")):
        if names:
            some = ", ".join(names[:NAMES_IN_BANNER]) + (" and others" if len(names) > NAMES_IN_BANNER else "")
            parts.append(f"{some} {one if len(names) == 1 else more}")
    if report.verdict == "pass" and verdicts:
        count = f"All {len(verdicts)} robots calibrate" if len(verdicts) > 1 else f"{next(iter(verdicts))} calibrates"
        parts.insert(0, f"{count} within the limits")
    sentence = join([element("strong", f"{'; '.join(parts)}. ") if parts else "", report.sentence])
    return element("div", verdict_line(report.verdict, sentence), class_=f"banner {report.verdict}")


def engine_of(results: PipelineResults) -> str:
    """Return the version of the engine that has calibrated; empty if nothing has."""
    snapshots = (cell.details.snapshot for cell in results.cells if cell.details)
    found = sorted({snapshot.engine for snapshot in snapshots if snapshot})
    return f"Calibration CI {', '.join(found)}" if found else ""


def overview_table(results: PipelineResults, anchors: Mapping[str, str]) -> Html:
    """Return the row of each robot, with a link to its section."""
    found = report_tables.overview_table(results)
    rows = [
        (element("a", row[0], href=f"#{anchors[row[0]]}") if row[0] in anchors else row[0], *map(_lines, row[1:]))
        for row in found.rows
    ]
    return table(found.columns, rows)


def _lines(text: str) -> Html | str:
    """Return parts of a text, between semicolons, below each other."""
    return join([element("div", part) for part in text.split("; ")]) if "; " in text else text


def starts_table(results: PipelineResults) -> Html:
    """Return the folded matrix of starts and robots, one number a cell; the others are its title."""
    own = PipelineResults(results.cells, tuple(each for each in results.comparisons if not each.by_other_method))
    found = report_tables.grid(own)
    rows = [(row[0], *map(_first_number, row[1:])) for row in found.rows]
    return folded(f"The matrix: {count_of(len(rows), 'start')}", table(found.columns, rows)) if rows else Html("")


def _first_number(text: str) -> Html:
    first, *others = text.split(", ")
    verdict = [other for other in others if other.isupper() or other.startswith(("FAIL", "UNDECIDED"))]
    return element("span", ", ".join((first, *verdict)), title=text)


def sensors_table(dataset: Dataset, by_sensor: Mapping[str, Residuals]) -> Html:
    """Return a row for each sensor: its lens and images, and how much of them was covered by corners."""
    rows = []
    for name, residuals in by_sensor.items():
        camera = dataset.sensors[name].camera
        lens = f"{camera.distortion.ros_name}, {camera.width} x {camera.height} px" if camera else "-"
        covered = f"{covered_share(camera, residuals):.0%}" if camera and residuals.where.shape[-1] == 2 else "-"
        views = str(len(np.unique(residuals.collections)))
        rows.append((name, lens, views, str(len(residuals.collections)), covered))
    return table(("Sensor", "Lens", "Images or scans", "Corners or points", "Image covered"), rows)


def covered_share(camera: Camera, residuals: Residuals) -> float:
    """Return the share of a camera's image, of its cells, in which corners were seen."""
    places = residuals.where / (camera.width, camera.height) * (COVERED_COLUMNS, COVERED_ROWS)
    inside = np.clip(places.astype(int), 0, (COVERED_COLUMNS - 1, COVERED_ROWS - 1))
    return len(np.unique(inside, axis=0)) / (COVERED_COLUMNS * COVERED_ROWS)


MIN_EXTENT = 1e-6
"""m or px: extent of a task's points from which there is a map of them."""


def task_figures(tasks: Sequence[TaskResult], maps: Sequence[TaskMap]) -> Iterator[Html]:
    """Yield the map of each task that has several points."""
    figures = [drawn for task, each in zip(tasks, maps, strict=True) if (drawn := _map_of_task(task, each))]
    if figures:
        yield element("h3", "How far off the robot is where it works")
        yield element("div", *figures, class_="figures")


def _map_of_task(task: TaskResult, of: TaskMap) -> Html | None:
    """Return a task's map: of an image, or along the two axes in which its points extend most; None of one point."""
    points, values = np.array(of.points), np.array([np.nan if each is None else each for each in of.most])
    extents = np.ptp(points, axis=0)
    if extents.max() < MIN_EXTENT:
        return None
    in_image = of.columns is not None
    first, second = (0, 1) if in_image else sorted(np.argsort(-extents, kind="stable")[:2].tolist())
    axes = ("u (px)", "v (px)") if in_image else (f"{'xyz'[first]} (m)", f"{'xyz'[second]} (m)")
    drawn = point_map(task.name, points[:, [first, second]], values, task.unit, axes, down=in_image)
    where = "over the image" if in_image else f"in {task.frame}"
    limit = "" if task.limit is None else f", limit {task.limit:.3g} {task.unit}"
    return figure(drawn, f"{task.name}: what the error stays below in 95 % of cases, {task.unit}, {where}{limit}.")
