"""Part of the page: maps of the error of the robot's tasks, over an image or the space where it works."""

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.ci.pages.charts import point_map
from calibration.ci.pages.html import Html, element, figure
from calibration.pipeline.matrix.cell_result import TaskMap, TaskResult

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
