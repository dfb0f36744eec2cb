"""Boards to print: a sheet as SVG and PDF, true to size, with a ruler that shows whether the printer kept it.

Both are written here: they hold filled rectangles and two lines of text, for which a library of PDF is no help.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.pattern import CIRCLE_KINDS
from calibration.robot.labelling.marked_boards import cell_ends, tag_cells
from calibration.robot.simulation.rendering.texture import circle_diameter, marker_modules, tag_modules

PAPER_SIZES_MM = {
    "A0": (841.0, 1189.0),
    "A1": (594.0, 841.0),
    "A2": (420.0, 594.0),
    "A3": (297.0, 420.0),
    "A4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
"""Widths and heights of papers, upright, mm."""
MARGIN_MM = 8.0
"""Width of the paper's edge that printers leave white, mm."""
FOOT_MM = 14.0
"""Height of the ruler with its text below the board, mm."""
RULER_MM, TICK_MM = 100.0, 10.0
"""Length of the ruler and distance of its ticks, mm."""
LINE_MM = 0.25
"""Width of the ruler's lines, mm."""
TEXT_MM = 3.0
"""Height of the text, mm."""
BEZIER_TANGENT = 4 / 3 * (np.sqrt(2) - 1)
"""Length of the tangents of a quarter of a circle as a cubic curve, in radii."""
POINTS_PER_MM = 72 / 25.4
"""Points of PDF per mm."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A board on paper; mm from the top left of the paper, y down."""

    width: float
    height: float
    board: tuple[float, float, float, float]
    """Left, top, width and height of the print, of an inverted one with black around it."""
    rectangles: Array
    """(N, 4): left, top, width and height of what is filled on the board."""
    circles: Array
    """(N, 3): x and y of the centres and the radii of filled circles."""
    inverted: bool
    """Whether the print is white on a black board."""
    ruler: Array
    """(N, 4): rectangles of the ruler's lines, black."""
    text: tuple[tuple[float, float, str], ...]
    """Left, base line and text."""


def board_sheet(pattern: PatternConfiguration, paper: str) -> Sheet:
    """Place a board in the middle of a paper, upright or lying.

    Raises:
        InputError: the board is larger than the paper.
    """
    rectangles, circles = np.zeros((0, 4)), np.zeros((0, 3))
    if pattern.kind in CIRCLE_KINDS:
        circles = 1000 * np.pad(
            pattern.pattern().corners[:, :2], ((0, 0), (0, 1)), constant_values=circle_diameter(pattern) / 2
        )
        circles[:, :2] += 1000 * pattern.size
        across, down = (float(n) for n in circles[:, :2].max(0) + 1000 * pattern.size)
    else:
        black, x, y = _black_cells(pattern)
        x, y = 1000 * x, 1000 * y
        rectangles, across, down = _black_rectangles(black, x, y), float(x[-1]), float(y[-1])
    short, long = PAPER_SIZES_MM[paper]
    room = ((short, long), (long, short))
    fitting = [(w, h) for w, h in room if across <= w - 2 * MARGIN_MM and down <= h - 2 * MARGIN_MM - FOOT_MM]
    if not fitting:
        share = max(min((w - 2 * MARGIN_MM) / across, (h - 2 * MARGIN_MM - FOOT_MM) / down) for w, h in room)
        side = (
            "tag" if pattern.kind in ("aprilgrid", "tags") else "spacing" if pattern.kind in CIRCLE_KINDS else "square"
        )
        raise InputError(
            f"the board is {across:g} x {down:g} mm, too large for {paper} with a margin of {MARGIN_MM:g} mm and a "
            "ruler: "
            f"take a larger paper, or a {side} of {np.floor(1000 * pattern.size * share * 10) / 10:g} mm at most"
        )
    width, height = fitting[0]
    left, top = (width - across) / 2, (height - FOOT_MM - down) / 2
    room_around = MARGIN_MM / 2 if pattern.inverted else 0.0
    base = height - MARGIN_MM - TEXT_MM - 1
    ticks = np.arange(0, RULER_MM + TICK_MM / 2, TICK_MM)
    lines = [
        [MARGIN_MM, base - LINE_MM, RULER_MM, LINE_MM],
        *([MARGIN_MM + t - LINE_MM / 2, base - 3, LINE_MM, 3] for t in ticks),
    ]
    says = f"{RULER_MM:g} mm: measure it; {_title_of_sheet(pattern)}"
    return Sheet(
        width=width,
        height=height,
        board=(left - room_around, top - room_around, across + 2 * room_around, down + 2 * room_around),
        rectangles=rectangles + np.array([left, top, 0.0, 0.0]),
        circles=circles + np.array([left, top, 0.0]),
        inverted=pattern.inverted,
        ruler=np.array(lines),
        text=((MARGIN_MM, height - MARGIN_MM, says),),
    )


def svg(sheet: Sheet) -> str:
    """Return a sheet as SVG, a unit of which is a millimetre."""
    board, fill = ("black", "white") if sheet.inverted else ("white", "black")
    size = f'width="{sheet.width:g}mm" height="{sheet.height:g}mm" viewBox="0 0 {sheet.width:g} {sheet.height:g}"'
    font = f'font-family="Helvetica" font-size="{TEXT_MM:g}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        _svg_rectangles(np.array([[0, 0, sheet.width, sheet.height]]), "white", "paper"),
        _svg_rectangles(np.array([sheet.board]), board, "board"),
        _svg_rectangles(sheet.rectangles, fill, "print"),
        *(f'<circle cx="{x:.5f}" cy="{y:.5f}" r="{r:.5f}" fill="{fill}"/>' for x, y, r in sheet.circles),
        _svg_rectangles(sheet.ruler, "black", "ruler"),
        *(f'<text x="{x:g}" y="{y:g}" {font}>{text}</text>' for x, y, text in sheet.text),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def pdf(sheet: Sheet) -> bytes:
    """Return a sheet as PDF 1.4 of one page."""
    board, fill = (0, 1) if sheet.inverted else (1, 0)
    content = "\n".join(
        [
            f"{board} g",
            _pdf_rectangles(sheet, np.array([sheet.board])),
            f"{fill} g",
            _pdf_rectangles(sheet, sheet.rectangles),
            *(_pdf_circle(x, sheet.height - y, r) for x, y, r in sheet.circles),
            "0 g",
            _pdf_rectangles(sheet, sheet.ruler),
            *(
                f"BT /F1 {TEXT_MM * POINTS_PER_MM:.4f} Tf {x * POINTS_PER_MM:.4f} "
                f"{(sheet.height - y) * POINTS_PER_MM:.4f} Td ({text}) Tj ET"
                for x, y, text in sheet.text
            ),
        ]
    )
    page = (
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {sheet.width * POINTS_PER_MM:.4f} "
        f"{sheet.height * POINTS_PER_MM:.4f}] "
        "/Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
    )
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        page,
        f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    text, places = "%PDF-1.4\n", []
    for number, each in enumerate(objects, 1):
        places.append(len(text))
        text += f"{number} 0 obj\n{each}\nendobj\n"
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    size = len(objects) + 1
    text += f"xref\n0 {size}\n0000000000 65535 f \n{table}trailer\n<< /Size {size} /Root 1 0 R >>\n"
    return f"{text}startxref\n{text.index('xref')}\n%%EOF\n".encode("ascii")


def _black_cells(pattern: PatternConfiguration) -> tuple[BoolArray, Array, Array]:
    """Return a print as black cells (R, C), and their ends along x (C + 1,) and along y (R + 1,), m from its corner."""
    if pattern.kind == "aprilgrid":
        x, y = cell_ends(*pattern.dimension, pattern.spacing)
        return tag_cells(*pattern.dimension, pattern.first_marker), x * pattern.size, y * pattern.size
    if pattern.kind == "tags":
        (white,) = tag_modules(pattern)
        ends = pattern.size * np.linspace(0, 1, len(white) + 1)
        return white < 0.5, ends, ends
    columns, rows = (n + 1 for n in pattern.dimension)
    black: BoolArray = np.indices((rows, columns)).sum(axis=0) % 2 == 0
    if pattern.kind != "charuco" or pattern.inner_size is None:
        return black, pattern.size * np.arange(columns + 1.0), pattern.size * np.arange(rows + 1.0)
    markers = marker_modules(pattern, int((~black).sum()))
    modules = len(markers[0])
    cells = np.repeat(np.repeat(black, modules + 2, axis=0), modules + 2, axis=1)
    for (row, column), bits in zip(np.argwhere(~black) * (modules + 2) + 1, markers, strict=True):
        cells[row : row + modules, column : column + modules] = bits < 0.5
    begin = (pattern.size - pattern.inner_size) / 2
    within = np.concatenate([[0.0], begin + pattern.inner_size * np.linspace(0, 1, modules + 1)])
    x, y = (
        np.append((pattern.size * np.arange(n)[:, None] + within).ravel(), n * pattern.size) for n in (columns, rows)
    )
    return cells, np.asarray(x, float), np.asarray(y, float)


def _black_rectangles(black: BoolArray, x: Array, y: Array) -> Array:
    """Return rectangles (N, 4) of the black cells: runs along a row, as far down as the next rows have the same."""
    found: list[list[float]] = []
    growing: dict[tuple[int, int], int] = {}
    for row in range(len(black) + 1):
        cells = black[row] if row < len(black) else np.zeros(black.shape[1], bool)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(int))).tolist()
        runs = set(zip(edges[::2], edges[1::2], strict=True))
        for run in [run for run in growing if run not in runs]:
            top = growing.pop(run)
            found.append([x[run[0]], y[top], x[run[1]] - x[run[0]], y[row] - y[top]])
        for run in runs:
            growing.setdefault(run, row)
    return np.array(sorted(found, key=lambda each: (each[1], each[0])))


def _title_of_sheet(pattern: PatternConfiguration) -> str:
    if pattern.kind == "tags":
        return f"{pattern.dictionary} {pattern.tags[0].id}, {1000 * pattern.size:g} mm"
    columns, rows = pattern.dimension
    what = {"aprilgrid": "tags", **dict.fromkeys(CIRCLE_KINDS, "circles")}.get(pattern.kind, "corners")
    return f"{pattern.kind} {columns} x {rows} {what}, {1000 * pattern.size:g} mm"


def _svg_rectangles(rectangles: Array, fill: str, name: str) -> str:
    each = "".join(f'<rect x="{x:.5f}" y="{y:.5f}" width="{w:.5f}" height="{h:.5f}"/>' for x, y, w, h in rectangles)
    edges = (
        "" if name == "ruler" else ' shape-rendering="crispEdges"'
    )  # else viewers show seams; thin lines would vanish
    return f'<g id="{name}" fill="{fill}"{edges}>{each}</g>'


def _pdf_rectangles(sheet: Sheet, rectangles: Array) -> str:
    """Return operators that fill rectangles; the origin of a page is its bottom left."""
    left, top, width, height = rectangles.T
    places = (POINTS_PER_MM * np.stack([left, sheet.height - top - height, width, height], -1)).tolist()
    return "\n".join([*(f"{x:.4f} {y:.4f} {w:.4f} {h:.4f} re" for x, y, w, h in places), "f"])


def _pdf_circle(x: float, y: float, radius: float) -> str:
    """Return operators that fill a circle (mm): four cubic curves, 0.03 % of the radius off at most."""
    right, up = radius * np.array([1.0, 0.0]), radius * np.array([0.0, 1.0])
    text = ""
    for _ in range(4):
        points = np.stack([right, right + BEZIER_TANGENT * up, up + BEZIER_TANGENT * right, up])
        start, *curve = (f"{POINTS_PER_MM * (x + px):.4f} {POINTS_PER_MM * (y + py):.4f}" for px, py in points.tolist())
        text += f"{'' if text else start + ' m '}{' '.join(curve)} c "
        right, up = up, -right
    return text + "f"
