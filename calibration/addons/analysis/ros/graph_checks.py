"""Checks of the graph: types, names, qualities of service, parameters and remappings that cannot fit."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import yaml

from calibration.addons.analysis.finding import CodeFinding
from calibration.addons.analysis.ros.faults import fault, quoted
from calibration.addons.analysis.ros.graph import CONNECTIONS, Endpoint, Graph, GraphNode, build_graphs
from calibration.addons.analysis.ros.launch import LaunchParameter
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.base.text import did_you_mean

_TOPICS_OF_ROS = ("/rosout", "/tf", "/tf_static", "/clock", "/parameter_events", "/robot_description")
"""Topics that nodes of ROS itself publish."""
_PARAMETERS_OF_ROS = ("use_sim_time", "qos_overrides", "start_type_description_service", "use_intra_process_comms")
"""Parameters that every node of ROS 2 takes."""


def check_graph(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check the nodes of every launch file together."""
    for graph in build_graphs(repository):
        yield from _check_node_names(graph)
        for title, giving, taking in CONNECTIONS:
            gives, takes = graph.of(giving), graph.of(taking)
            yield from _check_types(title, gives, takes)
            yield from _check_connections(title, gives, takes, graph)
        yield from _check_qualities(graph)
        for node in graph.nodes:
            yield from _check_parameters(node, repository)
            yield from _check_remappings(node)


def _check_node_names(graph: Graph) -> Iterator[CodeFinding]:
    first: dict[str, GraphNode] = {}
    for node in graph.nodes:
        if node.start is None or node.start.conditional or node.name is None:
            continue
        other = first.setdefault(node.name, node)
        if other is not node and other.start is not None:
            where = f"{other.start.path}:{other.start.line}"
            message = f"the name {quoted(node.name)} is that of a node in {where} too: one of them is shut down"
            yield fault("node-name-twice", node.start.path, node.start.line, message)


def _check_types(title: str, gives: list[Endpoint], takes: list[Endpoint]) -> Iterator[CodeFinding]:
    for name in sorted({each.name for each in (*gives, *takes)}):
        ends = [each for each in (*gives, *takes) if each.name == name and each.call.type]
        counts = Counter(each.call.type for each in ends)
        if len(counts) < 2:
            continue
        given = [each.call.type for each in gives if each.name == name and each.call.type]
        usual = max(counts, key=lambda each: (counts[each], each in given))
        for each in ends:
            if each.call.type != usual:
                other = next(end for end in ends if end.call.type == usual)
                where = f"{other.call.path}:{other.call.line}"
                message = f"{title[:-1]} {quoted(name)} is {each.call.type} here, and {usual} in {where}"
                yield fault("topic-types", each.call.path, each.call.line, message)


def _check_connections(title: str, gives: list[Endpoint], takes: list[Endpoint], graph: Graph) -> Iterator[CodeFinding]:
    """Yield uses of a name that nothing provides, such as a topic without a publisher, with a similar, unused one."""
    given, taken = {each.name for each in gives}, {each.name for each in takes}
    started = {node.title for node in graph.nodes if node.start is not None} or {node.title for node in graph.nodes}
    for each in takes:
        if each.name in given or each.name in _TOPICS_OF_ROS or each.node not in started:
            continue
        loose = [
            end.name for end in gives if end.name not in taken and _may_be_same_type(end.call.type, each.call.type)
        ]
        if hint := did_you_mean(each.name, loose):
            what = {"topics": "nothing publishes", "services": "nothing serves", "actions": "nothing serves"}[title]
            message = f"{what} {quoted(each.name)}{hint}"
            yield fault("not-connected", each.path, each.line, message)


def _may_be_same_type(one: str | None, other: str | None) -> bool:
    return one is None or other is None or one == other


def _check_qualities(graph: Graph) -> Iterator[CodeFinding]:
    for taker in graph.of("subscriber"):
        wanted = taker.call.quality
        for giver in graph.of("publisher"):
            given = giver.call.quality
            if giver.name != taker.name or wanted is None or given is None:
                continue
            where = f"{giver.call.path}:{giver.call.line}"
            if wanted.reliability == "reliable" and given.reliability == "best effort":
                message = (
                    f"{quoted(taker.name)} is published best effort in {where}, and a reliable subscriber gets nothing"
                )
                yield fault("quality-of-service", taker.call.path, taker.call.line, message)
            elif wanted.durability == "transient local" and given.durability == "volatile":
                message = f"{quoted(taker.name)} is volatile in {where}, and a transient local subscriber gets nothing"
                yield fault("quality-of-service", taker.call.path, taker.call.line, message)


def _check_parameters(node: GraphNode, repository: RosRepository) -> Iterator[CodeFinding]:
    """Yield parameters that are set for a node whose code has none of the name."""
    package = repository.by_name.get(node.package)
    calls = [each for each in node.calls if "parameter" in each.kind]
    if node.start is None or package is None or node.takes_any_parameter or any(each.name is None for each in calls):
        return
    declares = [each for each in calls if each.kind == "declared parameter"] if package.is_ros2 else calls
    names = {(each.name or "").lstrip("~/") for each in declares}
    for each in _parameters_set(node, repository, package.is_ros2):
        name = each.name.lstrip("~/")
        ends = {name[:at] for at, letter in enumerate(name) if letter in "./"} | {name}
        if not ends & names and name.partition(".")[0] not in _PARAMETERS_OF_ROS:
            hint = did_you_mean(name, names)
            message = f"{quoted(node.title)} has no parameter {quoted(name)}{hint}"
            yield fault("no-such-parameter", each.path, each.line, message)


def _parameters_set(node: GraphNode, repository: RosRepository, is_ros2: bool) -> Iterator[LaunchParameter]:
    if node.start is None:
        return
    yield from node.start.parameters
    for file in node.start.parameter_files:
        path = repository.place(file)
        if path is None or path not in repository.tree.present:
            continue
        text = repository.tree.text(path)
        if is_ros2:
            yield from parameters_of(path, text, node.name or "/")
        else:
            yield from private_parameters_of(path, text)


def _check_remappings(node: GraphNode) -> Iterator[CodeFinding]:
    """Yield remappings of names that the code does not use, where it uses a similar one that is not remapped."""
    uses = [each for each in node.calls if "parameter" not in each.kind]
    if node.start is None or not uses or any(each.name is None for each in uses):
        return
    names = {(each.name or "").strip("~/") for each in uses}
    olds = {(each.old or "").strip("~/") for each in node.start.remappings}
    for each in node.start.remappings:
        old = (each.old or "").strip("~/")
        if old not in names and (hint := did_you_mean(old, names - olds)):
            message = f"{quoted(node.title)} uses no {quoted(old)}{hint}"
            yield fault("unused-remapping", node.start.path, each.line, message)


_MAX_PARAMETERS = 5_000
_MAX_DEPTH = 20


def parameters_of(path: str, text: str, node: str) -> list[LaunchParameter]:
    """Return the parameters that a file of ROS 2 sets for a node of this full name."""
    found: list[LaunchParameter] = []
    short = node.rpartition("/")[2]
    for key, value in _entries_of_mapping(_parse_root(text)):
        if str(key.value) in ("/**", short, node, node.lstrip("/"), f"/**/{short}"):
            for inner, values in _entries_of_mapping(value):
                if inner.value == "ros__parameters":
                    found += _names_of_values(values, "", path, ".")
    return found[:_MAX_PARAMETERS]


def private_parameters_of(path: str, text: str) -> list[LaunchParameter]:
    """Return the names that a file of ROS 1 sets below where it is loaded."""
    return list(_names_of_values(_parse_root(text), "", path, "/"))[:_MAX_PARAMETERS]


def _parse_root(text: str) -> Any:
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return None


def _entries_of_mapping(node: Any) -> list[tuple[Any, Any]]:
    return node.value if isinstance(node, yaml.MappingNode) else []


def _names_of_values(node: Any, prefix: str, path: str, separator: str, depth: int = 0) -> Iterator[LaunchParameter]:
    """Yield the names of all values, nested ones joined by the separator."""
    for key, value in _entries_of_mapping(node) if depth < _MAX_DEPTH else ():
        name = f"{prefix}{key.value}"
        if isinstance(value, yaml.MappingNode):
            yield from _names_of_values(value, f"{name}{separator}", path, separator, depth + 1)
        else:
            yield LaunchParameter(name, path, key.start_mark.line + 1)
