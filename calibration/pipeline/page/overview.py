"""Head of the page, which a reader understands in seconds: verdict, robots, starts; sensors and tasks of a robot."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calibration.ci.pages.charts import point_map
from calibration.ci.pages.html import Html, element, figure, folded, join, table, verdict_line
from calibration.ci.report import Report, Verdict, count_of
from calibration.engine.dataset.model import Dataset
from calibration.engine.evaluation.label_errors import Residuals
from calibration.engine.geometry.cameras import Camera
from calibration.pipeline import report_blocks
from calibration.pipeline.matrix.cell_result import TaskMap, TaskResult
from calibration.pipeline.results import PipelineResults

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
    found = report_blocks.overview_table(results)
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
    found = report_blocks.grid(own)
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
