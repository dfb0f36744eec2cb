"""Graph of nodes that launch files start, with their topics, services and actions; its document and its picture.

In the picture nodes that give, topics, services and actions, and nodes that take stand from the left to the right.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape

from calibration.addons.analysis.ros.client_code import Call, ClientCode, Kind
from calibration.addons.analysis.ros.launch import Launch, NodeStart, resolved
from calibration.addons.analysis.ros.package import Package
from calibration.addons.analysis.ros.repository import RosRepository, with_imports
from calibration.addons.analysis.ros.tree import is_test_file

_MAX_INCLUDES = 500
CONNECTIONS: tuple[tuple[str, Kind, Kind], ...] = (
    ("topics", "publisher", "subscriber"),
    ("services", "server", "client"),
    ("actions", "action server", "action client"),
)
"""Kinds of connections: what gives, and what takes."""


@dataclass(frozen=True)
class Endpoint:
    """Use of a topic, service or action by a node."""

    node: str
    name: str
    """Full name, after remappings."""
    call: Call
    path: str
    """File that sets its name: the code, or the launch file that remaps it."""
    line: int


@dataclass(frozen=True)
class GraphNode:
    """A node that is started."""

    name: str | None
    """Full name; None if it is not known."""
    package: str
    executable: str
    start: NodeStart | None
    """Its entry in a launch file; None for a node that no launch file starts."""
    calls: tuple[Call, ...] = ()
    takes_any_parameter: bool = False
    namespace: str | None = ""

    @property
    def title(self) -> str:
        """The name, or that of the executable."""
        return self.name or f"{self.package}/{self.executable}"


@dataclass(frozen=True)
class Graph:
    """Nodes that run together."""

    root: str
    """Launch file that starts them; empty for those of no launch file."""
    nodes: tuple[GraphNode, ...]
    endpoints: tuple[Endpoint, ...]
    unresolved: tuple[str, ...]
    """Messages about what could not be read."""

    def of(self, *kinds: Kind) -> list[Endpoint]:
        """Return the endpoints of some kinds."""
        return [each for each in self.endpoints if each.call.kind in kinds]


@dataclass
class _Walk:
    """Walk through a launch file and those that it includes."""

    repository: RosRepository
    starts: list[NodeStart] = field(default_factory=list)
    unresolved: list[str] = field(default_factory=list)
    left: int = _MAX_INCLUDES

    def through(self, launch: Launch, namespace: str | None, conditional: bool, above: tuple[str, ...] = ()) -> None:
        """Add the nodes of a launch file that is included in a namespace."""
        self.left -= 1
        if launch.path in above or self.left < 0:
            return
        self.unresolved += launch.unresolved
        for start in launch.starts:
            inner = _join_namespaces(namespace, start.namespace)
            self.starts.append(replace(start, namespace=inner, conditional=start.conditional or conditional))
        for include in launch.includes:
            included = self.repository.included(include)
            if included is None:
                if include.file is None or "$(" in include.file:
                    self.unresolved.append(f"{include.path}:{include.line}: the included file")
                continue
            inner = _join_namespaces(namespace, include.namespace)
            self.through(included, inner, conditional or include.conditional, (*above, launch.path))


def _join_namespaces(outer: str | None, inner: str | None) -> str | None:
    if inner is None or (outer is None and not inner.startswith("/")):
        return None
    return inner.strip("/") if inner.startswith("/") else f"{outer}/{inner}".strip("/")


def build_graphs(repository: RosRepository) -> list[Graph]:
    """Return the graph of each launch file that no other one includes, or the one of all nodes if there is none.

    Executables that no launch file starts may be run beside any of them, so they are in every graph.
    """
    included = {
        launch.path
        for each in repository.launches.values()
        for include in each.includes
        if (launch := repository.included(include)) is not None and launch.path != each.path
    }
    roots = [each for path, each in repository.launches.items() if path not in included and not is_test_file(path)]
    started = {(each.package, each.executable) for launch in repository.launches.values() for each in launch.starts}
    others = list(_nodes_not_started(repository, started))
    graphs = []
    for root in roots:
        walk = _Walk(repository)
        walk.through(root, "", conditional=False)
        nodes = [_node_of_start(repository, start) for start in walk.starts]
        graphs.append(_connect_nodes(root.path, [*nodes, *others], walk.unresolved))
    return graphs or [_connect_nodes("", others, [])]


def _nodes_not_started(repository: RosRepository, started: set[tuple[str | None, str | None]]) -> Iterator[GraphNode]:
    """Yield the executables that no launch file starts."""
    for package in repository.packages:
        for name, sources in repository.executables(package).files.items():
            is_code = any(path.endswith((".py", ".cpp", ".cc", ".cxx")) for path in sources)
            if (package.name, name) in started or not is_code or any(map(is_test_file, sources)):
                continue
            code = _code_of_executable(repository, package, sources)
            if code.calls and code.node_names:
                title = resolved("", code.node_names[0]) if len(set(code.node_names)) == 1 else None
                yield GraphNode(title, package.name, name, None, code.calls, code.takes_any_parameter)


def _node_of_start(repository: RosRepository, start: NodeStart) -> GraphNode:
    package = repository.by_name.get(start.package or "")
    code = ClientCode(takes_any_parameter=True)
    if package is not None and start.executable is not None:
        sources = repository.executables(package).files.get(start.executable, ())
        code = _code_of_executable(repository, package, sources)
    names = code.node_names
    takes_any = code.takes_any_parameter or not names
    name = start.name if start.is_named else names[0] if len(set(names)) == 1 else start.executable
    full = None if name is None or start.namespace is None else resolved(start.namespace, name)
    package_name, executable = start.package or "?", start.executable or "?"
    return GraphNode(full, package_name, executable, start, code.calls, takes_any, start.namespace)


def _code_of_executable(repository: RosRepository, package: Package, sources: tuple[str, ...]) -> ClientCode:
    """Return the code of all files of an executable; its names are unknown if there is none."""
    paths = [path for each in sources for path in (with_imports(package, each) if each.endswith(".py") else (each,))]
    codes = [repository.code(path) for path in dict.fromkeys(paths)]
    return ClientCode(
        tuple(call for code in codes for call in code.calls),
        tuple(name for code in codes for name in code.node_names),
        any(code.takes_any_parameter for code in codes),
    )


def _connect_nodes(root: str, nodes: list[GraphNode], unresolved: list[str]) -> Graph:
    endpoints = []
    for node in nodes:
        for call in node.calls:
            if "parameter" in call.kind:
                continue
            if endpoint := _endpoint_of_call(node, call):
                endpoints.append(endpoint)
            else:
                unresolved.append(f"{call.path}:{call.line}: the name of a {call.kind}")
    return Graph(root, tuple(nodes), tuple(endpoints), tuple(dict.fromkeys(unresolved)))


def _endpoint_of_call(node: GraphNode, call: Call) -> Endpoint | None:
    """Return the use of a name, after the remappings of the node; None if it is not known."""
    remappings = node.start.remappings if node.start else ()
    if call.name is None or node.name is None or any(each.old is None for each in remappings):
        return None
    full, path, line = _resolve_name(node, call.name), call.path, call.line
    for each in remappings:
        if node.start and each.old and _resolve_name(node, each.old) == full:
            full = None if each.new is None else _resolve_name(node, each.new)
            path, line = node.start.path, each.line
            break
    return None if full is None else Endpoint(node.title, full, call, path, line)


def _resolve_name(node: GraphNode, name: str) -> str | None:
    if name.startswith("~"):
        return None if node.name is None else f"{node.name}/{name.lstrip('~/')}"
    return resolved(node.namespace, name)


def summary_of(graphs: list[Graph]) -> Mapping[str, object]:
    """Summarise all graphs: the numbers of nodes and connections, the connections, and their document as JSON text."""
    nodes = {(each.title, each.package, each.executable) for graph in graphs for each in graph.nodes}
    unresolved = dict.fromkeys(each for graph in graphs for each in graph.unresolved)
    document = {"schema": 1, "graphs": [_document_of_graph(each) for each in graphs]}
    return {
        "nodes": len(nodes),
        "connections": sorted({each for graph in graphs for each in _describe_connections(graph)}),
        "unresolved": list(unresolved),
        "document": json.dumps(document, indent=1) + "\n",
    }


def _describe_connections(graph: Graph) -> Iterator[str]:
    """Yield a line for each two nodes that a topic, service or action connects."""
    for _, giving, taking in CONNECTIONS:
        for giver in graph.of(giving):
            for taker in graph.of(taking):
                if giver.name == taker.name:
                    yield f"{giver.name}: {giver.node} -> {taker.node}"


def _document_of_graph(graph: Graph) -> Mapping[str, object]:
    nodes = [
        {"name": each.name, "package": each.package, "executable": each.executable, "started": each.start is not None}
        for each in graph.nodes
    ]
    found: dict[str, object] = {"launch": graph.root or None, "nodes": nodes}
    for title, giving, taking in CONNECTIONS:
        entries = {}
        for name in sorted({each.name for each in graph.of(giving, taking)}):
            ends = [each for each in graph.of(giving, taking) if each.name == name]
            entries[name] = {
                "types": sorted({each.call.type for each in ends if each.call.type}),
                "from": sorted({each.node for each in ends if each.call.kind == giving}),
                "to": sorted({each.node for each in ends if each.call.kind == taking}),
            }
        found[title] = entries
    return found | {"unresolved": list(graph.unresolved)}


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
