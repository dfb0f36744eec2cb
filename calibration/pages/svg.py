"""What the figures share: the drawing's frame, axes and ticks, and how many points are drawn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.geometry.types import Array, IntArray
from calibration.pages.html import Html, element


def drawing(width: float, height: float, title: str, *children: str) -> Html:
    """Return an SVG of so many pixels that shrinks with the page; the title is for those who do not see it."""
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
    """Return round numbers inside of an interval."""
    if not high > low:
        return [low]
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next((m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= most), 10)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{i * step:.10g}") for i in range(first, last + 1)]


@dataclass(frozen=True)
class Axis:
    """How values lie along a side of a figure."""

    low: float
    high: float
    start: float
    """Where the lowest stands, px."""
    end: float

    def __call__(self, value: float) -> float:
        """Return where a value stands, px."""
        return self.start + (value - self.low) / ((self.high - self.low) or 1.0) * (self.end - self.start)

    def marks(self, most: int = 6) -> list[tuple[float, str]]:
        """Return where ticks stand, and their labels."""
        return [(self(value), f"{value:g}") for value in ticks(self.low, self.high, most)]


def text(x: float, y: float, content: str, anchor: str = "middle", class_: str | None = None) -> Html:
    """Return a text at a place."""
    return element("text", content, x=x, y=y, text_anchor=anchor, class_=class_)


def thinned(count: int, most: int) -> IntArray:
    """Return indices of evenly spaced entries, at most so many, of so many."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def path(points: Sequence[Array] | Array, closed: bool = False) -> str:
    """Return the ``d`` of a path through points (N, 2)."""
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else "")
