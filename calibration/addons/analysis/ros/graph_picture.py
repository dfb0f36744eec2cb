"""Picture of graphs: nodes that give, topics, services and actions, nodes that take, from the left to the right."""

from collections.abc import Iterator, Sequence
from html import escape

from calibration.addons.analysis.ros.graph import CONNECTIONS, Endpoint, Graph

_ROW_HEIGHT, _TOP_MARGIN, _SVG_WIDTH = 26, 48, 1000
_X_OF_GIVERS, _X_OF_NAMES, _X_OF_TAKERS = 250, 500, 750
"""Positions: the end of the left column, the middle of the names, the start of the right column."""
_HALF_WIDTH_OF_NAMES = 150
"""Half of the width of the names."""
_MAX_PICTURE_ROWS = 150
"""Limit of rows in a picture."""
_COLOUR_OF_CONNECTION = {"topics": "#1f6feb", "services": "#8250df", "actions": "#bc4c00"}
_GIVING_KINDS = {giving for _, giving, _ in CONNECTIONS}


def picture(graphs: Sequence[Graph]) -> str:
    """Return the SVG of graphs, all in one."""
    uses = [each for graph in graphs for each in graph.endpoints]
    names = [
        (title, name)
        for title, *kinds in CONNECTIONS
        for name in sorted({each.name for each in uses if each.call.kind in kinds})
    ][:_MAX_PICTURE_ROWS]
    gives, takes = (
        sorted({each.node for each in uses if (each.call.kind in _GIVING_KINDS) == giving})[:_MAX_PICTURE_ROWS]
        for giving in (True, False)
    )
    height = _TOP_MARGIN + _ROW_HEIGHT * (max(len(gives), len(names), len(takes)) + 1)
    texts = [
        *(_text_svg(_X_OF_GIVERS, at, name, "end", "#24292f") for at, name in enumerate(gives)),
        *(
            _text_svg(_X_OF_NAMES, at, name, "middle", _COLOUR_OF_CONNECTION[kind])
            for at, (kind, name) in enumerate(names)
        ),
        *(_text_svg(_X_OF_TAKERS, at, name, "start", "#24292f") for at, name in enumerate(takes)),
    ]
    lines = dict.fromkeys(_arrows_svg(uses, names, gives, takes))
    newline, width = "\n", _SVG_WIDTH
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">
<title>Nodes, and the topics, services and actions that they use</title>
<defs><marker id="to" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 8 4 0 8z" fill="#57606a"/></marker></defs>
<rect width="{_SVG_WIDTH}" height="{height}" fill="#ffffff"/>
<g font-family="sans-serif" font-size="13">
<text x="{_X_OF_GIVERS}" y="24" text-anchor="end" font-weight="bold">publish, serve</text>
<text x="{_X_OF_NAMES}" y="24" text-anchor="middle" font-weight="bold">{_legend_svg()}</text>
<text x="{_X_OF_TAKERS}" y="24" font-weight="bold">subscribe, call</text>
{newline.join(texts)}
</g>
<g stroke="#57606a" stroke-width="1.2" marker-end="url(#to)">
{newline.join(lines)}
</g>
</svg>
"""


def _legend_svg() -> str:
    return ", ".join(f'<tspan fill="{colour}">{title}</tspan>' for title, colour in _COLOUR_OF_CONNECTION.items())


def _y_of_row(row: int) -> float:
    return _TOP_MARGIN + _ROW_HEIGHT * (row + 0.5)


def _text_svg(x: int, row: int, text: str, anchor: str, colour: str) -> str:
    shown = text if len(text) <= 36 else f"…{text[-35:]}"
    return f'<text x="{x}" y="{_y_of_row(row) + 4:g}" text-anchor="{anchor}" fill="{colour}">{escape(shown)}</text>'


def _arrows_svg(
    uses: Sequence[Endpoint], names: Sequence[tuple[str, str]], gives: Sequence[str], takes: Sequence[str]
) -> Iterator[str]:
    """Yield an arrow from each node to what it gives to, and from each name to the nodes that take from it."""
    left, middle, right = ({each: _y_of_row(at) for at, each in enumerate(column)} for column in (gives, names, takes))
    titles = {kind: title for title, *kinds in CONNECTIONS for kind in kinds}
    for each in uses:
        name = middle.get((titles[each.call.kind], each.name))
        is_giving = each.call.kind in _GIVING_KINDS
        node = (left if is_giving else right).get(each.node)
        if name is not None and node is not None:
            x1, y1, x2, y2 = (
                (_X_OF_GIVERS + 8, node, _X_OF_NAMES - _HALF_WIDTH_OF_NAMES, name)
                if is_giving
                else (_X_OF_NAMES + _HALF_WIDTH_OF_NAMES, name, _X_OF_TAKERS - 8, node)
            )
            yield f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"/>'
