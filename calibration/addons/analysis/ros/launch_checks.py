"""Checks of launch files and robot descriptions, and of the graph of the nodes that they start.

What they start, include and name exists; types, names, qualities of service, parameters and remappings fit.
"""

import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

import yaml

from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros import fault, quoted
from calibration.addons.analysis.ros.graph import CONNECTIONS, Endpoint, Graph, GraphNode, build_graphs
from calibration.addons.analysis.ros.launch import Include, Launch, LaunchParameter, package_of
from calibration.addons.analysis.ros.repository import RosRepository, is_installed
from calibration.addons.analysis.ros.tree import compose_yaml, entries_of, is_test_file, reachable, without_comments
from calibration.base import did_you_mean

_SUFFIXES_READ_ONLY = (
    *(".launch", ".py", ".xml", ".yaml", ".yml", ".urdf", ".xacro", ".srdf", ".sdf", ".world", ".rviz", ".gazebo"),
    *(".stl", ".dae", ".obj", ".json", ".pgm"),
)
"""Suffixes of files that launch files and descriptions read; others may be written."""
_RESOURCE_PATH = re.compile(r"package://[\w-]+/[^\"'\s<>&]+|\$\(find[ \t]+[\w-]+\)/[^\"'\s<>&]+")


def check_launches(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check every launch file and robot description."""
    for launch in repository.launches.values():
        yield from _check_executables(launch, repository)
        for text, line in launch.files:
            yield from _check_file(text, launch.path, line, repository)
        for include in launch.includes:
            yield from _check_include(include, repository)
        yield from _check_arguments(launch)
        yield from _check_cycles(launch, repository)
    for package in repository.packages:
        for path in package.files:
            if path.endswith((".urdf", ".xacro")):
                text = without_comments(repository.tree.text(path))
                for number, content in enumerate(text.split("\n"), 1):
                    for match in _RESOURCE_PATH.findall(content):
                        named = re.sub(r"\$\(find[ \t]+([\w-]+)\)", r"package://\1", match)
                        yield from _check_file(named, path, number, repository)


def _check_executables(launch: Launch, repository: RosRepository) -> Iterator[CodeFinding]:
    for start in launch.starts:
        package = repository.by_name.get(start.package or "")
        if package is None or start.executable is None:
            continue
        executables = repository.executables(package)
        named = start.executable in executables.files or start.executable in package.build_words
        if not named and executables.is_complete:
            names = [each for each, sources in executables.files.items() if sources]
            message = f"{quoted(package.name)} has no executable {quoted(start.executable)}"
            yield fault("no-such-executable", start.path, start.line, message, start.executable, names)


def _check_file(text: str, path: str, line: int, repository: RosRepository) -> Iterator[CodeFinding]:
    named = package_of(text)
    package = repository.by_name.get(named[0]) if named else None
    if named is None or package is None or not named[1].lower().endswith(_SUFFIXES_READ_ONLY) or is_test_file(path):
        return
    inside = named[1]
    if inside.rpartition("/")[2] in package.build_words:  # generated, downloaded, or installed by name
        return
    folders = {package.folder.rpartition("/")[2], package.name}
    if any(f"{each}/{inside}" in repository.image_text for each in folders):
        return  # copied there when an image is built
    if not repository.tree.has(package.inside(inside)):
        folder, _, name = inside.rpartition("/")
        beside = [each for each in package.files if package.relative(each).rpartition("/")[0] == folder]
        message = f"{quoted(package.name)} has no file {quoted(inside)}"
        yield fault("no-such-file", path, line, message, name, [each.rpartition("/")[2] for each in beside])
    elif not is_installed(package, inside):
        message = f"{quoted(package.name)} does not install {quoted(inside)}: it is not found after an installation"
        yield fault("not-installed", path, line, message)


def _check_include(include: Include, repository: RosRepository) -> Iterator[CodeFinding]:
    launch = repository.included(include)
    if launch is None or include.passes_all:
        return
    python = launch.path.endswith(".py")
    for name, line in include.arguments.items():
        if name not in launch.arguments and not (python and name in dict(launch.used)):
            message = f"{launch.path} declares no argument {quoted(name)}"
            yield fault("launch-argument", include.path, line, message, name, launch.arguments)
    for name, has_value in launch.arguments.items():
        if not has_value and name not in include.arguments:
            message = f"{launch.path} needs the argument {quoted(name)}, which is not given"
            yield fault("launch-argument", include.path, include.line, message)


def _check_arguments(launch: Launch) -> Iterator[CodeFinding]:
    for name, line in launch.used:
        if name and name not in launch.arguments and re.fullmatch(r"\w+", name):
            hint = did_you_mean(name, launch.arguments)
            if launch.path.endswith(".py") and not hint:
                continue  # the file that includes it may declare it
            message = f"the argument {quoted(name)} is used, but not declared{hint}"
            yield fault("launch-argument", launch.path, line, message)


def _check_cycles(launch: Launch, repository: RosRepository) -> Iterator[CodeFinding]:
    def included(each: Launch | None) -> list[Launch | None]:
        return [repository.included(inner) for inner in each.includes if not inner.conditional] if each else []

    for include in launch.includes:
        first = [] if include.conditional else [repository.included(include)]
        if launch in reachable(first, included):
            message = f"{quoted(include.file or '')} includes this file again, without an end"
            yield fault("launch-cycle", launch.path, include.line, message)


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
            end.name
            for end in gives
            if end.name not in taken and (None in (end.call.type, each.call.type) or end.call.type == each.call.type)
        ]
        if hint := did_you_mean(each.name, loose):
            what = {"topics": "nothing publishes", "services": "nothing serves", "actions": "nothing serves"}[title]
            message = f"{what} {quoted(each.name)}{hint}"
            yield fault("not-connected", each.path, each.line, message)


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
            message = f"{quoted(node.title)} has no parameter {quoted(name)}"
            yield fault("no-such-parameter", each.path, each.line, message, name, names)


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
    for key, value in entries_of(compose_yaml(text)):
        if str(key.value) in ("/**", short, node, node.lstrip("/"), f"/**/{short}"):
            for inner, values in entries_of(value):
                if inner.value == "ros__parameters":
                    found += _names_of_values(values, "", path, ".")
    return found[:_MAX_PARAMETERS]


def private_parameters_of(path: str, text: str) -> list[LaunchParameter]:
    """Return the names that a file of ROS 1 sets below where it is loaded."""
    return list(_names_of_values(compose_yaml(text), "", path, "/"))[:_MAX_PARAMETERS]


def _names_of_values(node: Any, prefix: str, path: str, separator: str, depth: int = 0) -> Iterator[LaunchParameter]:
    """Yield the names of all values, nested ones joined by the separator."""
    for key, value in entries_of(node) if depth < _MAX_DEPTH else ():
        name = f"{prefix}{key.value}"
        if isinstance(value, yaml.MappingNode):
            yield from _names_of_values(value, f"{name}{separator}", path, separator, depth + 1)
        else:
            yield LaunchParameter(name, path, key.start_mark.line + 1)
