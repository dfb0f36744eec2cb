"""Draws docs/recording.svg: every curve of what makes a recording good (`make pictures`)."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.recording import measured_curves
from benchmarks.recording.curve import Curve

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "recording.svg"
COLUMNS = 3


def main() -> None:
    """Measure and draw."""
    curves = measured_curves(quick=False)
    rows = -(-len(curves) // COLUMNS)
    # Without dates and random ids, equal figures are equal bytes.
    with mpl.rc_context({"svg.hashsalt": "recording", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(11, 3 * rows), layout="constrained", facecolor="white")
        for axes, curve in zip(np.ravel(figure.subplots(rows, COLUMNS)), curves, strict=False):
            _draw(axes, curve)
        figure.savefig(PICTURE, metadata={"Date": None})


def _draw(axes: Axes, curve: Curve) -> None:
    x, y = np.array(curve.x), np.array(curve.y)
    found = np.isfinite(y)
    top = 1.15 * y[found].max()
    axes.axvspan(*curve.recommended, color="#2e9e5b", alpha=0.15, lw=0)
    axes.plot(x[found], y[found], "o-", color="#1f5fa8", ms=4)
    axes.plot(x[~found], np.full((~found).sum(), 0.95 * top), "x", color="#c0392b", label="not found")
    if not found.all():
        axes.legend(frameon=False, loc="best")
    axes.set(title=curve.title, xlabel=curve.property_name, ylabel=curve.unit, ylim=(0, top))
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main()
