"""Histogram with the density of the stated normal distribution."""

import math

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.svg import Axis, drawing, path, text

WIDTH, HEIGHT, MARGIN = 420.0, 200.0, 34.0
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
    x = Axis(edges[0], edges[-1], MARGIN, WIDTH - 10)
    density = [
        len(values) * (edges[1] - edges[0]) * math.exp(-0.5 * (v / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
        for v in edges
    ]
    y = Axis(0.0, 1.05 * max(counts.max(initial=1), *density), HEIGHT - MARGIN, 8)
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
    axis = element("path", d=f"M{MARGIN} {y(0):.1f}H{WIDTH - 10}", class_="axis")
    marks = [text(at, HEIGHT - MARGIN + 16, label) for at, label in x.marks()]
    title = (
        f"{name}: {len(values)} values; stated standard deviation {sigma:.3g} {unit}, found {np.std(values):.3g} {unit}"
    )
    return drawing(WIDTH, HEIGHT, title, bars, curve, axis, *marks, text(WIDTH - 10, HEIGHT - 4, unit, "end"))
