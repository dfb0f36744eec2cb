"""Report of ``convergence``: a table and a panel of the figure for each map."""

import io
import math
import shlex
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base import CalibrationError, InputError, number_text, one_line, shorten
from calibration.base.optional import figures_of_matplotlib, optional
from calibration.ci.report import FILES, Lines, Outcome, Report, Table, outcome_of_check
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, ConvergenceResults, without_noise
from calibration.pipeline.matrix.cell_result import noise_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Rectangle


MAX_MAPS = 24
PANEL_COLUMNS = 2
_CELL_SIDE, _MARGIN_WIDTH, _MARGIN_HEIGHT = 0.44, 1.3, 1.35
"""Inches: the side of a cell, and the margins of a panel."""
_MIN_WIDTH = 4.2
_DOTS_PER_INCH = 130
_COLOUR_MAP = "cividis"
"""Perceptually uniform, also for the colour-blind and in print."""
_MAX_DARK_PERCENT = 55
"""Percent below which numbers are white."""
_OUTLINE_COLOUR = "#c8102e"


def figures(results: ConvergenceResults) -> tuple[bytes, bytes]:
    """Draw the maps as PNG and SVG; the same results give the same bytes with the same matplotlib.

    Raises:
        InputError: there are too many maps.
        InfrastructureError: matplotlib is not installed.
    """
    if len(results.maps) > MAX_MAPS:
        raise InputError(f"no figure: found {len(results.maps)} maps, at most {MAX_MAPS} can be drawn")
    rectangle = optional("matplotlib.patches", "the figure").Rectangle
    with figures_of_matplotlib(9) as matplotlib_figures:
        columns = min(PANEL_COLUMNS, len(results.maps))
        rows = math.ceil(len(results.maps) / columns)
        width = max(_CELL_SIDE * len(results.noise.rotations) + _MARGIN_WIDTH, _MIN_WIDTH)
        height = _CELL_SIDE * len(results.noise.translations) + _MARGIN_HEIGHT
        size = (columns * width, rows * height + 0.5)
        drawing = matplotlib_figures.Figure(figsize=size, dpi=_DOTS_PER_INCH, layout="constrained")
        seeds = len(results.noise.seeds)
        drawing.suptitle(f"Starts that converge, % of {seeds} for each pair of noises", fontsize=11)
        for number, each in enumerate(results.maps):
            _draw_panel(drawing.add_subplot(rows, columns, number + 1), each, rectangle)
        png, svg = io.BytesIO(), io.BytesIO()
        drawing.savefig(png, format="png", metadata={"Software": None})
        drawing.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return png.getvalue(), svg.getvalue()


def _draw_panel(axes: "Axes", map_: ConvergenceMap, rectangle: "type[Rectangle]") -> None:
    shares = [[100 * map_.pairs[t, r].share for r in map_.rotations] for t in map_.translations]
    axes.imshow(shares, cmap=_COLOUR_MAP, vmin=0, vmax=100, origin="lower", aspect="equal")
    for y, t in enumerate(map_.translations):
        for x, r in enumerate(map_.rotations):
            pair = map_.pairs[t, r]
            colour = "white" if 100 * pair.share < _MAX_DARK_PERCENT else "black"
            weight = "bold" if pair.always else "normal"
            axes.text(x, y, pair.percent, ha="center", va="center", color=colour, fontsize=8, fontweight=weight)
    rotations = [number_text(r) for r in map_.rotations]
    slant = 45.0 if max(map(len, rotations)) > 4 else 0.0  # degrees: long labels would overlap
    axes.set_xticks(range(len(rotations)), rotations, rotation=slant)
    axes.set_yticks(range(len(map_.translations)), [number_text(t) for t in map_.translations])
    axes.set(xlabel="Rotation noise (rad)", ylabel="Translation noise (m)")
    title, text = shorten(one_line(map_.name), 60), "not even without noise"
    if map_.largest.diagonal is not None:  # the cells up to it are outlined
        translation, rotation = map_.largest.diagonal
        text = f"all, up to {number_text(translation)} m with {number_text(rotation)} rad (outlined)"
        width, height = map_.rotations.index(rotation) + 1, map_.translations.index(translation) + 1
        box = rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=_OUTLINE_COLOUR, linewidth=2, clip_on=False)
        box.set_zorder(3)
        axes.add_patch(box)
    axes.set_title(f"{title}\n{text}", fontsize=9)


SCHEMA_FILE = Path(__file__).with_name("convergence.schema.json")
COMMAND_NAME = "convergence"
TABLE_FILE, LARGEST_FILE = "convergence.csv", "largest-noise.csv"
PNG_FILE, SVG_FILE = "convergence.png", "convergence.svg"
ALL_FILES = (*FILES, TABLE_FILE, LARGEST_FILE, PNG_FILE, SVG_FILE)
"""Names of all output files of a sweep, except for those of the team's software."""
LOST_SHOWN = 10
"""Limit of the maps with a named initial guess that does not converge."""


def report(results: ConvergenceResults, output: Path, source: str = "--config calibration.yml") -> Report:
    """Return the report, with its figures if they can be drawn.

    Args:
        results: the results.
        output: the folder for the results.
        source: option that selects the swept systems, for commands to paste.
    """
    notes: tuple[str, ...] = ()
    pictures: dict[str, str | bytes] = {}
    try:
        pictures = dict(zip((PNG_FILE, SVG_FILE), figures(results), strict=True))
    except CalibrationError as error:  # matplotlib is not installed, or there are too many maps
        notes = (str(error),)
    lost = tuple(line for map_ in results.maps if (line := first_lost(map_, source)))
    largest = results.largest
    translation, rotation = largest.diagonal or (None, None)
    return Report(
        title="Convergence",
        verdict=results.verdict,
        error=results.exit_code,
        sentence=_convergence_sentence(results),
        reasons=tuple(results.reasons),
        notes=notes,
        blocks=(
            largest_table(results),
            *map(map_table, results.maps),
            Lines(lost, most=LOST_SHOWN, title="Starts that do not converge: one of each map"),
            Lines(notes),
        ),
        suites={COMMAND_NAME: list(_junit_outcomes(results))},
        results=replace(results, figures=tuple(pictures), notes=notes),
        outputs={
            "largest-translation-noise": largest.translation,
            "largest-rotation-noise": largest.rotation,
            "largest-diagonal-translation-noise": translation,
            "largest-diagonal-rotation-noise": rotation,
            "table": output / TABLE_FILE,
            "figure": output / PNG_FILE if pictures else None,
            "output": output,
        },
        files={TABLE_FILE: starts(results).csv(), LARGEST_FILE: largest_noise(results).csv(), **pictures},
    )


def map_table(map_: ConvergenceMap) -> Table:
    """Return the convergence rate in percent of each pair of noises."""
    starts = len(next(iter(map_.pairs.values())).cells)
    return Table(
        ("", *(f"{number_text(r)} rad" for r in map_.rotations)),
        tuple(
            # in the format of the noise pairs
            (f"{number_text(t)} m", *(map_.pairs[t, r].percent for r in map_.rotations))
            for t in map_.translations
        ),
        title=f"{map_.name}: starts that converge, % of {starts}",
    )


def largest_table(results: ConvergenceResults) -> Table:
    """Return the largest noise up to which everything converges, a row for each map."""

    def shown(value: float | None, unit: str) -> str:
        return "none" if value is None else f"{number_text(value)} {unit}"

    rows = (
        (
            map_.name if map_.judged else f"{map_.name} (to compare)",
            shown(map_.largest.translation, "m"),
            shown(map_.largest.rotation, "rad"),
            noise_text(*map_.largest.diagonal) if map_.largest.diagonal else "none",
        )
        for map_ in results.maps
    )
    return Table(("Every start converges up to", "Translation alone", "Rotation alone", "Both, up to"), tuple(rows))


def starts(results: ConvergenceResults) -> Table:
    """Return a row for each map and pair of noises, for ``convergence.csv``."""
    header = ("Cell", "System", "Method", "Start", "Translation noise (m)", "Rotation noise (rad)")
    rows = (
        (
            f"{each.name}, {noise_text(*noise)}",
            *(each.system, each.method, each.start),
            *map(number_text, noise),
            str(pair.starts),
            str(pair.converged),
            number_text(pair.share),
            " ".join(map(str, pair.lost)),
            pair.reason,
        )
        for each in results.maps
        for noise, pair in each.pairs.items()
    )
    return Table((*header, "Starts", "Converged", "Share", "Lost seeds", "First reason"), tuple(rows))


def largest_noise(results: ConvergenceResults) -> Table:
    """Return a row for each map, for ``largest-noise.csv``; an empty cell, which fails every rule, if there is none."""
    header = ("Map", "Translation noise (m)", "Rotation noise (rad)")
    rows = []
    for each in results.maps:
        largest = each.largest
        values = (largest.translation, largest.rotation, *(largest.diagonal or (None, None)))
        rows.append((each.name, *("" if value is None else number_text(value) for value in values)))
    return Table((*header, "Diagonal translation noise (m)", "Diagonal rotation noise (rad)"), tuple(rows))


def first_lost(map_: ConvergenceMap, source: str) -> str:
    """Return an initial guess with the least noise that does not converge, and its command; empty if all converge.

    Args:
        map_: the map.
        source: option that selects the swept systems.
    """
    for (t, r), pair in map_.pairs.items():
        if pair.lost:
            which = source if source.startswith("--dataset") else f"{source} --systems {shlex.quote(map_.system)}"
            options = f"{which} --translation-noise {number_text(t)} --rotation-noise {number_text(r)}"
            how = f"calibration calibrate-matrix {options} --seed-list {pair.lost[0]} --start {map_.start}"
            return f"{map_.name}, {noise_text(t, r)}, seed {pair.lost[0]}: {pair.reason}: to look at it, {how}"
    return ""


def _convergence_sentence(results: ConvergenceResults) -> str:
    largest = results.largest
    if largest.diagonal is None:
        return "the start without noise does not converge"
    return (
        f"every start converges up to {number_text(largest.translation or 0.0)} m alone, "
        f"{number_text(largest.rotation or 0.0)} rad alone, and {noise_text(*largest.diagonal)} together"
    )


def _junit_outcomes(results: ConvergenceResults) -> Iterable[Outcome]:
    """Return the cases of JUnit: each map without noise, and each check."""
    for map_ in results.judged:
        why = without_noise(map_)
        if map_.error is not None and not why:
            why = "a start could not be run: see results.json"
        name = f"{map_.name}: converges without noise"
        yield Outcome(name=name, group=map_.system, reasons=(why,) if why else (), error=map_.error)
    for check in results.checks:
        yield outcome_of_check(check, COMMAND_NAME)
