"""Chart of a value over commits, with error bars."""

from collections.abc import Sequence

import numpy as np

from calibration.ci.pages.html import Html, element
from calibration.ci.pages.svg import Axis, drawing, path, text

MAX_LABEL_CHARACTERS = 18
"""Maximum number of characters of a label below the chart."""
WIDTH, HEIGHT, LEFT, MARGIN = 420.0, 170.0, 44.0, 26.0


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
    x = Axis(0, max(len(values) - 1, 1), LEFT + 10, WIDTH - 14)
    y = Axis(low - room, high + room, HEIGHT - MARGIN, 22)
    parts = [element("path", d=f"M{LEFT} {at:.1f}H{WIDTH}", class_="grid") for at, _ in y.marks()]
    parts += [text(LEFT - 5, at + 4, label, "end", "small") for at, label in y.marks()]
    parts.append(text(LEFT - 5, 11, unit, "end"))
    points = np.array([(x(i), y(value)) for i, value in enumerate(values)])
    bars = "".join(
        f"M{x(i):.1f} {y(v - s):.1f}V{y(v + s):.1f}" for i, (v, s) in enumerate(zip(values, sigmas, strict=True))
    )
    parts += [element("path", d=bars, class_="vector"), element("path", d=path(points), class_="stated")]
    for (px, py), label, value in zip(points.tolist(), labels, values, strict=True):
        tooltip = element("title", f"{label}: {value:.3g} {unit}")
        parts.append(element("circle", tooltip, cx=px, cy=py, r=3.5, class_="bar"))
    ends = [text(LEFT + 4, HEIGHT - 8, labels[0][:MAX_LABEL_CHARACTERS], "start", "small")]
    ends += [text(WIDTH - 4, HEIGHT - 8, labels[-1][:MAX_LABEL_CHARACTERS], "end", "small")]
    title = f"{name}, {unit}, over {len(values)} accepted calibrations: last {values[-1]:.3g} {unit}"
    return drawing(WIDTH, HEIGHT, title, *parts, *(ends if len(labels) > 1 else ends[:1]))
