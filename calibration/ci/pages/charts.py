"""Charts as SVG: heat maps, histograms, error ellipses and trends; root, axes and text that all figures share."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.ci.pages.html import Html, element, join


def drawing(width: float, height: float, title: str, *children: str) -> Html:
    """Return an SVG element of a size in pixels that shrinks with the page; the title is for screen readers."""
    return element(
        "svg",
        element("title", title),
        *children,
        viewBox=f"0 0 {width:g} {height:g}",
        width=width,
        role="img",
        aria_label=title,
    )


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Return at most ``most`` round numbers within an interval."""
    if not high > low:
        return [low]
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next((m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= most), 10)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{i * step:.10g}") for i in range(first, last + 1)]


@dataclass(frozen=True)
class Axis:
    """Linear scale from values to positions along a side of a figure."""

    low: float
    high: float
    start: float
    """Position of the lowest value, px."""
    end: float

    def __call__(self, value: float) -> float:
        """Return the position of a value, px."""
        return self.start + (value - self.low) / ((self.high - self.low) or 1.0) * (self.end - self.start)

    def marks(self, most: int = 6) -> list[tuple[float, str]]:
        """Return the positions of ticks, and their labels."""
        return [(self(value), f"{value:g}") for value in ticks(self.low, self.high, most)]


def text(x: float, y: float, content: str, anchor: str = "middle", class_: str | None = None) -> Html:
    """Return a text element at a position."""
    return element("text", content, x=x, y=y, text_anchor=anchor, class_=class_)


def thinned(count: int, most: int) -> IntArray:
    """Return at most ``most`` evenly spaced indices below ``count``."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def path(points: Sequence[Sequence[float]] | Array, closed: bool = False) -> str:
    """Return the ``d`` of a path through points (N, 2)."""
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in np.asarray(points).tolist()) + ("Z" if closed else "")


SCALE_STEPS, SCALE_STEP_WIDTH, SCALE_HEIGHT = 6, 26.0, 38.0


def _opacity(fraction: float) -> float:
    """Return the opacity of a value that is a fraction of the largest."""
    return 0.08 + 0.92 * fraction


def colour_scale(left: float, top: float, most: float, unit: str) -> Html:
    """Return the scale of the colours from 0 to the largest value."""
    steps = [
        element(
            "rect",
            x=left + step * SCALE_STEP_WIDTH,
            y=top + 4,
            width=SCALE_STEP_WIDTH,
            height=12,
            class_="heat",
            fill_opacity=_opacity(step / (SCALE_STEPS - 1)),
        )
        for step in range(SCALE_STEPS)
    ]
    right = left + SCALE_STEPS * SCALE_STEP_WIDTH
    ends = [text(left, top + 30, "0", "start", "small"), text(right, top + 30, f"{most:.3g} {unit}", "end", "small")]
    return join([*steps, *ends])


HEAT_LEFT, HEAT_TOP, HEAT_CELL, HEAT_CELL_HEIGHT = 150.0, 8.0, 22.0, 24.0
MAX_COLUMNS = 120
"""Maximum number of columns; above it, neighbours are merged into one that shows their maximum."""


def heat_map(
    title: str, rows: Sequence[str], columns: Sequence[str], values: Array, unit: str, column: str = "collection"
) -> Html:
    """Return the figure.

    Args:
        title: title of the figure.
        rows: names, R of them.
        columns: names, C of them.
        values: (R, C); NaN for missing values.
        unit: unit of the values.
        column: what a column is, in the singular.
    """
    step = math.ceil(len(columns) / MAX_COLUMNS)
    groups = [list(range(i, min(i + step, len(columns)))) for i in range(0, len(columns), step)]
    finite = [float(v) for v in values.ravel() if math.isfinite(v)]
    most = max(finite, default=1.0) or 1.0
    width = HEAT_LEFT + max(HEAT_CELL * len(groups), 160.0) + 8
    parts = []
    for r, name in enumerate(rows):
        y = HEAT_TOP + r * HEAT_CELL_HEIGHT
        parts.append(text(HEAT_LEFT - 8, y + HEAT_CELL_HEIGHT * 0.68, _short_name(name), "end"))
        for c, group in enumerate(groups):
            found = [float(values[r, i]) for i in group if math.isfinite(values[r, i])]
            if not found:
                continue
            value = max(found)
            where = columns[group[0]] if len(group) == 1 else f"{columns[group[0]]} to {columns[group[-1]]}"
            cell = element("title", f"{name}, {column} {where}: {value:.3g} {unit}")
            box = {"x": HEAT_LEFT + c * HEAT_CELL, "y": y, "width": HEAT_CELL - 1.5, "height": HEAT_CELL_HEIGHT - 1.5}
            parts.append(element("rect", cell, **box, class_="heat", fill_opacity=_opacity(value / most)))
    below = HEAT_TOP + len(rows) * HEAT_CELL_HEIGHT
    every = max(1, math.ceil(len(groups) * 30 / max(HEAT_CELL * len(groups), 1)))
    labels = [
        text(HEAT_LEFT + (c + 0.45) * HEAT_CELL, below + 14, columns[group[0]], class_="small")
        for c, group in enumerate(groups)
        if c % every == 0
    ]
    scale = colour_scale(HEAT_LEFT, below + 20, most, unit)
    return drawing(width, below + 20 + SCALE_HEIGHT, f"{title}: at most {most:.3g} {unit}", *parts, *labels, scale)


def _short_name(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:19]}…"


HISTOGRAM_WIDTH, HISTOGRAM_HEIGHT, HISTOGRAM_MARGIN = 420.0, 200.0, 34.0
BIN_COUNT = 48
HALF_WIDTH_IN_DEVIATIONS = 5.0
"""Half the width of the histogram, in standard deviations."""


def histogram(name: str, values: Array, sigma: float, unit: str) -> Html:
    """Return the figure.

    Args:
        name: name of the counted quantity.
        values: (n,).
        sigma: stated standard deviation.
        unit: unit of both.
    """
    if not sigma > 0:
        sigma = float(np.std(values)) or 1.0
    edges = np.linspace(-HALF_WIDTH_IN_DEVIATIONS * sigma, HALF_WIDTH_IN_DEVIATIONS * sigma, BIN_COUNT + 1)
    counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
    x = Axis(edges[0], edges[-1], HISTOGRAM_MARGIN, HISTOGRAM_WIDTH - 10)
    density = [
        len(values) * (edges[1] - edges[0]) * math.exp(-0.5 * (v / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
        for v in edges
    ]
    y = Axis(0.0, 1.05 * max(counts.max(initial=1), *density), HISTOGRAM_HEIGHT - HISTOGRAM_MARGIN, 8)
    bars = element(
        "path",
        d="".join(
            f"M{x(left):.1f} {y(0):.1f}V{y(count):.1f}H{x(right):.1f}V{y(0):.1f}Z"
            for left, right, count in zip(edges[:-1], edges[1:], counts.tolist(), strict=True)
            if count
        ),
        class_="bar",
    )
    curve = element(
        "path", d=path([(x(v), y(n)) for v, n in zip(edges.tolist(), density, strict=True)]), class_="stated"
    )
    axis = element("path", d=f"M{HISTOGRAM_MARGIN} {y(0):.1f}H{HISTOGRAM_WIDTH - 10}", class_="axis")
    marks = [text(at, HISTOGRAM_HEIGHT - HISTOGRAM_MARGIN + 16, label) for at, label in x.marks()]
    title = (
        f"{name}: {len(values)} values; stated standard deviation {sigma:.3g} {unit}, found {np.std(values):.3g} {unit}"
    )
    return drawing(
        HISTOGRAM_WIDTH,
        HISTOGRAM_HEIGHT,
        title,
        bars,
        curve,
        axis,
        *marks,
        text(HISTOGRAM_WIDTH - 10, HISTOGRAM_HEIGHT - 4, unit, "end"),
    )


PLANE_SIDE, PLANE_GAP = 150.0, 14.0
AXES_OF_PLANE = ((0, 1), (0, 2), (1, 2))


def ellipses(name: str, covariance: Array, limit: float | None) -> Html:
    """Return the figure: ellipses of two standard deviations, and the limit as a circle.

    Args:
        name: name of the object at the position.
        covariance: (3, 3), mm^2.
        limit: mm; None for no limit.
    """
    largest = 2 * float(np.sqrt(np.linalg.eigvalsh(covariance).max()))
    span = 1.15 * max(largest, limit or 0.0, 1e-9)
    scale = (PLANE_SIDE / 2 - 4) / span
    parts = []
    for k, (i, j) in enumerate(AXES_OF_PLANE):
        x, y = PLANE_SIDE / 2 + k * (PLANE_SIDE + PLANE_GAP), PLANE_SIDE / 2
        values, vectors = np.linalg.eigh(covariance[np.ix_([i, j], [i, j])])
        a, b = (2 * float(np.sqrt(max(v, 0.0))) * scale for v in values[::-1])
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        turn = f"translate({x:.1f} {y:.1f}) rotate({-angle:.1f})"
        parts += [
            element(
                "path",
                d=f"M{x - PLANE_SIDE / 2:.1f} {y}h{PLANE_SIDE}M{x:.1f} {y - PLANE_SIDE / 2}v{PLANE_SIDE}",
                class_="grid",
            ),
            element("circle", cx=x, cy=y, r=limit * scale, class_="limit") if limit else Html(""),
            element("ellipse", rx=max(a, 0.75), ry=max(b, 0.75), transform=turn, class_="ellipse"),
            text(x + PLANE_SIDE / 2 - 2, y - 5, "xyz"[i], "end", "small"),
            text(x + 5, y - PLANE_SIDE / 2 + 11, "xyz"[j], "start", "small"),
        ]
    scale_text = f"at most {largest:.3g} mm" + (f"; the circle is the limit, {limit:g} mm" if limit else "")
    parts.append(text(4, PLANE_SIDE + 13, scale_text, "start", "small"))
    title = f"{name}: two standard deviations, {scale_text}"
    return drawing(3 * PLANE_SIDE + 2 * PLANE_GAP, PLANE_SIDE + 20, title, join(parts))


MAP_WIDTH, MAP_MARGIN, MAP_RADIUS = 420.0, 34.0, 9.0
MAX_NUMBERED_POINTS = 80
"""Points of a map up to which each has its value beside it."""


def point_map(title: str, points: Array, values: Array, unit: str, axes: tuple[str, str], down: bool = False) -> Html:
    """Return the figure: points in a plane, the stronger, the larger their values.

    Args:
        title: title of the figure.
        points: (n, 2).
        values: (n,); points with NaN are left empty.
        unit: unit of the values.
        axes: names of the two axes, with their unit.
        down: whether the second one points down, as in an image.
    """
    (left, low), (right, high) = points.min(0).tolist(), points.max(0).tolist()
    room = MAP_WIDTH - 2 * MAP_MARGIN
    height = min(room, max(60.0, room * (high - low) / ((right - left) or 1.0)))
    x = Axis(left, right, MAP_MARGIN + 8, MAP_WIDTH - MAP_MARGIN)
    bottom, top = MAP_MARGIN / 2 + height, MAP_MARGIN / 2
    y = Axis(low, high, top, bottom) if down else Axis(low, high, bottom, top)
    most = float(np.nanmax(values)) or 1.0
    parts = [text(at, bottom + 36, label, class_="small") for at, label in x.marks()]
    parts += [text(MAP_MARGIN - 8, at + 4, label, "end", "small") for at, label in y.marks()]
    for (u, v), value in zip(points.tolist(), values.tolist(), strict=True):
        if math.isfinite(value):
            name = element("title", f"({u:.4g}, {v:.4g}): {value:.3g} {unit}")
            strength = _opacity(value / most)
            dot = {"cx": x(u), "cy": y(v), "r": MAP_RADIUS}
            parts.append(element("circle", name, **dot, class_="heat", fill_opacity=strength))
            if len(points) <= MAX_NUMBERED_POINTS:
                parts.append(text(x(u), y(v) + MAP_RADIUS + 10, f"{value:.2g}", class_="small"))
        else:
            parts.append(element("circle", cx=x(u), cy=y(v), r=2, class_="grid"))
    parts.append(
        text(MAP_WIDTH / 2, bottom + 52, f"{axes[0]} across, {axes[1]} {'down' if down else 'up'}", class_="small")
    )
    parts.append(colour_scale(MAP_MARGIN, bottom + 56, most, unit))
    return drawing(MAP_WIDTH, bottom + 56 + SCALE_HEIGHT, f"{title}: at most {most:.3g} {unit}", *parts)


MAX_LABEL_CHARACTERS = 18
"""Maximum number of characters of a label below the chart."""
TREND_WIDTH, TREND_HEIGHT, TREND_LEFT, TREND_MARGIN = 420.0, 170.0, 44.0, 26.0


def trend(name: str, labels: Sequence[str], values: Sequence[float], sigmas: Sequence[float], unit: str) -> Html:
    """Return the figure.

    Args:
        name: name of the quantity.
        labels: names of the commits, n of them; the first and the last are shown.
        values: n values.
        sigmas: their standard deviations, n.
        unit: unit of both.
    """
    low = min(v - s for v, s in zip(values, sigmas, strict=True))
    high = max(v + s for v, s in zip(values, sigmas, strict=True))
    room = 0.08 * (high - low) or 1.0
    x = Axis(0, max(len(values) - 1, 1), TREND_LEFT + 10, TREND_WIDTH - 14)
    y = Axis(low - room, high + room, TREND_HEIGHT - TREND_MARGIN, 22)
    parts = [element("path", d=f"M{TREND_LEFT} {at:.1f}H{TREND_WIDTH}", class_="grid") for at, _ in y.marks()]
    parts += [text(TREND_LEFT - 5, at + 4, label, "end", "small") for at, label in y.marks()]
    parts.append(text(TREND_LEFT - 5, 11, unit, "end"))
    points = np.array([(x(i), y(value)) for i, value in enumerate(values)])
    bars = "".join(
        f"M{x(i):.1f} {y(v - s):.1f}V{y(v + s):.1f}" for i, (v, s) in enumerate(zip(values, sigmas, strict=True))
    )
    parts += [element("path", d=bars, class_="vector"), element("path", d=path(points), class_="stated")]
    for (px, py), label, value in zip(points.tolist(), labels, values, strict=True):
        tooltip = element("title", f"{label}: {value:.3g} {unit}")
        parts.append(element("circle", tooltip, cx=px, cy=py, r=3.5, class_="bar"))
    ends = [text(TREND_LEFT + 4, TREND_HEIGHT - 8, labels[0][:MAX_LABEL_CHARACTERS], "start", "small")]
    ends += [text(TREND_WIDTH - 4, TREND_HEIGHT - 8, labels[-1][:MAX_LABEL_CHARACTERS], "end", "small")]
    title = f"{name}, {unit}, over {len(values)} accepted calibrations: last {values[-1]:.3g} {unit}"
    return drawing(TREND_WIDTH, TREND_HEIGHT, title, *parts, *(ends if len(labels) > 1 else ends[:1]))
