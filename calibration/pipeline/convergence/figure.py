"""Figure of the convergence maps: one panel each, with the share that converges in every cell."""

import io
import math
import warnings
from typing import TYPE_CHECKING, Any

from calibration.base.errors import InputError
from calibration.base.optional import optional
from calibration.base.tables.numbers import number_text
from calibration.base.text import one_line, shorten
from calibration.pipeline.convergence.convergence_map import ConvergenceMap
from calibration.pipeline.convergence.results import ConvergenceResults

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Rectangle

MOST_MAPS = 24
COLUMNS = 2
_CELL, _MARGIN_WIDTH, _MARGIN_HEIGHT = 0.44, 1.3, 1.35
"""Inches: the side of a cell, and the margins of a panel."""
_LEAST_WIDTH = 4.2
_DPI = 130
_COLOURS = "cividis"
"""Perceptually uniform, also for the colour-blind and in print."""
_DARK = 55
"""Percent below which numbers are white."""
_OUTLINE = "#c8102e"
_STYLE: Any = {
    "font.size": 9,
    "font.family": ["DejaVu Sans"],  # bundled with matplotlib: the same picture on every machine
    "text.parse_math": False,  # names come from the user and may contain $
    "svg.hashsalt": "calibration-ci",
    "svg.fonttype": "path",
}


def figures(results: ConvergenceResults) -> tuple[bytes, bytes]:
    """Draw the maps as PNG and SVG; the same results give the same bytes with the same matplotlib.

    Raises:
        InputError: there are too many maps.
        InfrastructureError: matplotlib is not installed.
    """
    if len(results.maps) > MOST_MAPS:
        raise InputError(f"no figure: found {len(results.maps)} maps, at most {MOST_MAPS} can be drawn")
    figure, patches = (optional(f"matplotlib.{name}", "the figure") for name in ("figure", "patches"))
    rc_context = optional("matplotlib", "the figure").rc_context
    with rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in a script that the font lacks
        columns = min(COLUMNS, len(results.maps))
        rows = math.ceil(len(results.maps) / columns)
        width = max(_CELL * len(results.noise.rotations) + _MARGIN_WIDTH, _LEAST_WIDTH)
        height = _CELL * len(results.noise.translations) + _MARGIN_HEIGHT
        size = (columns * width, rows * height + 0.5)
        drawing = figure.Figure(figsize=size, dpi=_DPI, layout="constrained")
        seeds = len(results.noise.seeds)
        drawing.suptitle(f"Starts that converge, % of {seeds} for each pair of noises", fontsize=11)
        for number, each in enumerate(results.maps):
            _panel(drawing.add_subplot(rows, columns, number + 1), each, patches.Rectangle)
        png, svg = io.BytesIO(), io.BytesIO()
        drawing.savefig(png, format="png", metadata={"Software": None})
        drawing.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return png.getvalue(), svg.getvalue()


def _panel(axes: "Axes", of: ConvergenceMap, rectangle: "type[Rectangle]") -> None:
    shares = [[100 * of.pairs[t, r].share for r in of.rotations] for t in of.translations]
    axes.imshow(shares, cmap=_COLOURS, vmin=0, vmax=100, origin="lower", aspect="equal")
    for y, t in enumerate(of.translations):
        for x, r in enumerate(of.rotations):
            pair = of.pairs[t, r]
            colour = "white" if 100 * pair.share < _DARK else "black"
            weight = "bold" if pair.always else "normal"
            axes.text(x, y, pair.percent, ha="center", va="center", color=colour, fontsize=8, fontweight=weight)
    axes.set_xticks(range(len(of.rotations)), [number_text(r) for r in of.rotations], rotation=_turned(of.rotations))
    axes.set_yticks(range(len(of.translations)), [number_text(t) for t in of.translations])
    axes.set(xlabel="Rotation noise (rad)", ylabel="Translation noise (m)")
    axes.set_title(f"{shorten(one_line(of.name), 60)}\n{_largest(of)}", fontsize=9)
    _outline(axes, of, rectangle)


def _turned(levels: tuple[float, ...]) -> float:
    """Return the rotation of labels in degrees: long ones would overlap."""
    return 45.0 if max(len(number_text(level)) for level in levels) > 4 else 0.0


def _largest(of: ConvergenceMap) -> str:
    if of.largest.diagonal is None:
        return "not even without noise"
    translation, rotation = of.largest.diagonal
    return f"all, up to {number_text(translation)} m with {number_text(rotation)} rad (outlined)"


def _outline(axes: "Axes", of: ConvergenceMap, rectangle: "type[Rectangle]") -> None:
    """Mark the cells up to the largest diagonal noise."""
    if of.largest.diagonal is not None:
        translation, rotation = of.largest.diagonal
        width, height = of.rotations.index(rotation) + 1, of.translations.index(translation) + 1
        box = rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=_OUTLINE, linewidth=2, clip_on=False)
        box.set_zorder(3)
        axes.add_patch(box)
