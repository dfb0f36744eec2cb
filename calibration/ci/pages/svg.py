"""Common parts of the figures: SVG root, axes and ticks, thinning of points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.ci.pages.html import Html, element


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
