"""Figure of the trends: displacement of each pose from the first accepted one, with its changes."""

import io
import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.base.errors import InputError
from calibration.base.optional import optional
from calibration.base.text import one_line, shorten
from calibration.pipeline.history import History, Trend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_PANELS = 24
COLUMNS = 2
TICKS = 6
MARKED = 60
"""Above this number of points, a line has no markers."""
_WIDTH, _HEIGHT = 5.0, 2.2
"""Size of a panel in inches."""
_LINE, _BAND, _CHANGE = "#1f5fa8", "#b9cfe8", "#c8102e"
_STYLE: Any = {
    "font.size": 8,
    "font.family": ["DejaVu Sans"],  # bundled with matplotlib: the same picture on every machine
    "text.parse_math": False,  # names come from the user and may contain $
    "svg.hashsalt": "calibration-ci",
    "svg.fonttype": "path",
}


def figure(found: History) -> bytes:
    """Draw the trends as SVG; the same history gives the same bytes with the same matplotlib.

    Raises:
        InputError: there are too many trends.
        InfrastructureError: matplotlib is not installed.
    """
    if len(found.trends) > MOST_PANELS:
        raise InputError(f"no figure: found {len(found.trends)} trends, at most {MOST_PANELS} can be drawn: --systems")
    figures, rc_context = optional("matplotlib.figure", "the figure"), optional("matplotlib", "the figure").rc_context
    with rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in a script that the font lacks
        columns = min(COLUMNS, len(found.trends))
        rows = math.ceil(len(found.trends) / columns)
        drawing = figures.Figure(figsize=(columns * _WIDTH, rows * _HEIGHT + 0.4), layout="constrained")
        drawing.suptitle("Since the first accepted calibration", fontsize=10)
        for number, trend in enumerate(found.trends):
            _panel(drawing.add_subplot(rows, columns, number + 1), trend)
        svg = io.BytesIO()
        drawing.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return svg.getvalue()


def _panel(axes: "Axes", trend: Trend) -> None:
    at = np.arange(len(trend.points))
    marker = "." if len(at) <= MARKED else ""
    if trend.name == "RMS":
        axes.plot(at, [point.rms_px or 0.0 for point in trend.points], "-", marker=marker, color=_LINE)
        axes.set_ylabel("px")
    else:
        moved = np.array([point.translation_mm for point in trend.points])
        sigma = max(point.sigma_mm for point in trend.points) / math.sqrt(3)
        for axis, style in zip("xyz", ("-", "--", ":"), strict=True):
            values = moved[:, "xyz".index(axis)]
            axes.fill_between(at, values - sigma, values + sigma, color=_BAND, alpha=0.4, linewidth=0)
            axes.plot(at, values, style, marker=marker, color=_LINE, label=axis)
        axes.set_ylabel("mm")
        axes.legend(loc="upper left", ncols=3, frameon=False)
    for step in trend.steps:
        place = next(i for i, point in enumerate(trend.points) if point.commit == step.commit)
        axes.axvline(place - 0.5, color=_CHANGE, linewidth=1)
        axes.annotate(
            step.commit[:7], (place - 0.5, 1.0), xycoords=("data", "axes fraction"), color=_CHANGE, fontsize=6
        )
    crept = f", creeping: {trend.crept_mm:.2g} mm" if trend.crept_mm is not None else ""
    axes.set_title(f"{shorten(one_line(f'{trend.system}: {trend.name}'), 50)}{crept}", loc="left", pad=10)
    shown = at[:: max(1, math.ceil(len(at) / TICKS))]
    axes.set_xticks(shown, [trend.points[i].date for i in shown])
