"""Picture of a graph: nodes on the left, topics on the right, a line for each connection."""

from collections.abc import Iterator
from html import escape

from calibration.analysis.ros.graph import CONNECTIONS, Graph

_ROW, _LEFT, _RIGHT, _WIDTH, _TOP = 26, 340, 560, 920, 40
_MOST = 150
"""Limit of rows in a picture."""
_COLOURS = {"topics": "#1f6feb", "services": "#8250df", "actions": "#bc4c00"}


def picture(graph: Graph) -> str:
    """Return the SVG of a graph."""
    nodes = sorted({each.node for each in graph.endpoints})[:_MOST]
    names = [
        (title, name) for title, *kinds in CONNECTIONS for name in sorted({each.name for each in graph.of(*kinds)})
    ][:_MOST]
    height = _TOP + _ROW * (max(len(nodes), len(names)) + 1)
    title = escape(f"Nodes and topics of {graph.root or 'all executables'}")
    lines = "\n".join(_lines(graph, nodes, names))
    texts = "\n".join(
        [
            *(_text(_LEFT, at, name, "end", "#24292f") for at, name in enumerate(nodes)),
            *(_text(_RIGHT, at, name, "start", _COLOURS[kind]) for at, (kind, name) in enumerate(names)),
        ]
    )
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" width="{_WIDTH}" role="img">
<title>{title}</title>
<defs><marker id="to" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 8 4 0 8z" fill="#57606a"/></marker></defs>
<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>
<g font-family="sans-serif" font-size="13">
<text x="{_LEFT}" y="20" text-anchor="end" font-weight="bold">nodes</text>
<text x="{_RIGHT}" y="20" font-weight="bold">{_legend()}</text>
{texts}
</g>
<g stroke="#57606a" stroke-width="1.2" marker-end="url(#to)">
{lines}
</g>
</svg>
"""


def _legend() -> str:
    return ", ".join(f'<tspan fill="{colour}">{title}</tspan>' for title, colour in _COLOURS.items())


def _y(row: int) -> float:
    return _TOP + _ROW * (row + 0.5)


def _text(x: int, row: int, text: str, anchor: str, colour: str) -> str:
    shown = text if len(text) <= 46 else f"{text[:45]}…"
    return f'<text x="{x}" y="{_y(row) + 4:g}" text-anchor="{anchor}" fill="{colour}">{escape(shown)}</text>'


def _lines(graph: Graph, nodes: list[str], names: list[tuple[str, str]]) -> Iterator[str]:
    """Yield an arrow from each node to what it gives to, and from each name to the nodes that take from it."""
    rows = {node: at for at, node in enumerate(nodes)}
    places = {each: at for at, each in enumerate(names)}
    drawn: dict[tuple[float, ...], None] = {}
    for title, giving, taking in CONNECTIONS:
        for each in graph.of(giving, taking):
            if each.node not in rows or (title, each.name) not in places:
                continue
            left, right = (_LEFT + 8, _y(rows[each.node])), (_RIGHT - 8, _y(places[title, each.name]))
            drawn[(*left, *right) if each.call.kind == giving else (*right, *left)] = None
    for x1, y1, x2, y2 in drawn:
        yield f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"/>'
