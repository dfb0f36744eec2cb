"""Heat map: rows of sensors, columns of collections, stronger colour for larger values."""

import math
from collections.abc import Sequence

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.svg import drawing, text

LEFT, TOP, CELL, HIGH = 150.0, 8.0, 22.0, 24.0
MAX_COLUMNS = 120
"""Maximum number of columns; above it, neighbours are merged into one that shows their maximum."""


def heat_map(title: str, rows: Sequence[str], columns: Sequence[str], values: Array, unit: str) -> Html:
    """Return the figure.

    Args:
        title: title of the figure.
        rows: names, R of them.
        columns: names, C of them.
        values: (R, C); NaN for missing values.
        unit: unit of the values.
    """
    step = math.ceil(len(columns) / MAX_COLUMNS)
    groups = [list(range(i, min(i + step, len(columns)))) for i in range(0, len(columns), step)]
    finite = [float(v) for v in values.ravel() if math.isfinite(v)]
    most = max(finite, default=1.0) or 1.0
    width = LEFT + max(CELL * len(groups), 160.0) + 8
    parts = []
    for r, name in enumerate(rows):
        y = TOP + r * HIGH
        parts.append(text(LEFT - 8, y + HIGH * 0.68, _short_name(name), "end"))
        for c, group in enumerate(groups):
            found = [float(values[r, i]) for i in group if math.isfinite(values[r, i])]
            if not found:
                continue
            value = max(found)
            where = columns[group[0]] if len(group) == 1 else f"{columns[group[0]]} to {columns[group[-1]]}"
            cell = element("title", f"{name}, collection {where}: {value:.3g} {unit}")
            box = {"x": LEFT + c * CELL, "y": y, "width": CELL - 1.5, "height": HIGH - 1.5}
            parts.append(element("rect", cell, **box, class_="heat", fill_opacity=0.08 + 0.92 * (value / most)))
    below = TOP + len(rows) * HIGH
    every = max(1, math.ceil(len(groups) * 30 / max(CELL * len(groups), 1)))
    labels = [
        text(LEFT + (c + 0.45) * CELL, below + 14, columns[group[0]], class_="small")
        for c, group in enumerate(groups)
        if c % every == 0
    ]
    return drawing(width, below + 20, f"{title}: at most {most:.3g} {unit}", *parts, *labels)


def _short_name(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:19]}…"
