"""Picture of graphs: nodes that give, topics, services and actions, nodes that take, from the left to the right."""

from collections.abc import Iterator, Sequence
from html import escape

from calibration.addons.analysis.ros.graph import CONNECTIONS, Endpoint, Graph

_ROW, _TOP, _WIDTH = 26, 48, 1000
_GIVES, _NAMES, _TAKES = 250, 500, 750
"""Positions: the end of the left column, the middle of the names, the start of the right column."""
_HALF = 150
"""Half of the width of the names."""
_MOST = 150
"""Limit of rows in a picture."""
_COLOURS = {"topics": "#1f6feb", "services": "#8250df", "actions": "#bc4c00"}
_GIVING = {giving for _, giving, _ in CONNECTIONS}


def picture(graphs: Sequence[Graph]) -> str:
    """Return the SVG of graphs, all in one."""
    uses = [each for graph in graphs for each in graph.endpoints]
    names = [
        (title, name)
        for title, *kinds in CONNECTIONS
        for name in sorted({each.name for each in uses if each.call.kind in kinds})
    ][:_MOST]
    gives, takes = (
        sorted({each.node for each in uses if (each.call.kind in _GIVING) == giving})[:_MOST]
        for giving in (True, False)
    )
    height = _TOP + _ROW * (max(len(gives), len(names), len(takes)) + 1)
    texts = [
        *(_text(_GIVES, at, name, "end", "#24292f") for at, name in enumerate(gives)),
        *(_text(_NAMES, at, name, "middle", _COLOURS[kind]) for at, (kind, name) in enumerate(names)),
        *(_text(_TAKES, at, name, "start", "#24292f") for at, name in enumerate(takes)),
    ]
    lines = dict.fromkeys(_lines(uses, names, gives, takes))
    newline = "\n"
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" width="{_WIDTH}" role="img">
<title>Nodes, and the topics, services and actions that they use</title>
<defs><marker id="to" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 8 4 0 8z" fill="#57606a"/></marker></defs>
<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>
<g font-family="sans-serif" font-size="13">
<text x="{_GIVES}" y="24" text-anchor="end" font-weight="bold">publish, serve</text>
<text x="{_NAMES}" y="24" text-anchor="middle" font-weight="bold">{_legend()}</text>
<text x="{_TAKES}" y="24" font-weight="bold">subscribe, call</text>
{newline.join(texts)}
</g>
<g stroke="#57606a" stroke-width="1.2" marker-end="url(#to)">
{newline.join(lines)}
</g>
</svg>
"""


def _legend() -> str:
    return ", ".join(f'<tspan fill="{colour}">{title}</tspan>' for title, colour in _COLOURS.items())


def _y(row: int) -> float:
    return _TOP + _ROW * (row + 0.5)


def _text(x: int, row: int, text: str, anchor: str, colour: str) -> str:
    shown = text if len(text) <= 36 else f"…{text[-35:]}"
    return f'<text x="{x}" y="{_y(row) + 4:g}" text-anchor="{anchor}" fill="{colour}">{escape(shown)}</text>'


def _lines(
    uses: Sequence[Endpoint], names: Sequence[tuple[str, str]], gives: Sequence[str], takes: Sequence[str]
) -> Iterator[str]:
    """Yield an arrow from each node to what it gives to, and from each name to the nodes that take from it."""
    left, middle, right = ({each: _y(at) for at, each in enumerate(column)} for column in (gives, names, takes))
    titles = {kind: title for title, *kinds in CONNECTIONS for kind in kinds}
    for each in uses:
        name = middle.get((titles[each.call.kind], each.name))
        is_giving = each.call.kind in _GIVING
        node = (left if is_giving else right).get(each.node)
        if name is not None and node is not None:
            x1, y1, x2, y2 = (
                (_GIVES + 8, node, _NAMES - _HALF, name) if is_giving else (_NAMES + _HALF, name, _TAKES - 8, node)
            )
            yield f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"/>'
