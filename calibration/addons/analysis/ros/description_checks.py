"""Checks against robot descriptions: frames and topics that a calibration names, and sizes of meshes."""

import json
import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros import fault, quoted
from calibration.addons.analysis.ros.graph import build_graphs
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import compose_yaml, entries_of, join, line_of, parse_xml, without_comments
from calibration.base import did_you_mean

_MAX_CONFIGURATION_BYTES = 50_000_000
_FRAME_KEYS = ("link", "parent_link", "child_link", "world_link")
_LINK_ELEMENT = re.compile(r"<link\s[^>]*name\s*=\s*[\"']([^\"']+)[\"']")


@dataclass(frozen=True)
class _Description:
    """Frames of a robot."""

    path: str
    links: frozenset[str]
    parents: Mapping[str, str]
    """Parent of each link with one."""
    is_complete: bool
    """Whether it has no other links: xacro may make some."""


@dataclass(frozen=True)
class _Named:
    """A key that names a frame in a configuration, and its value."""

    key: str
    value: str
    line: int
    group: int
    """Number of the mapping that it is in."""


def check_frames(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check the configurations of calibrations, and the datasets that carry one."""
    published: frozenset[str] | None = None
    for path in repository.tree.files:
        found = _read_configuration(repository, path)
        if found is None:
            continue
        named, description_file = found
        description = _find_description(repository, path, description_file)
        if description is not None:
            yield from _check_frames(path, named, description, _static_frames(repository))
        if published is None:
            graphs = build_graphs(repository)
            published = frozenset(end.name for graph in graphs for end in graph.of("publisher"))
        yield from _check_topics(path, named, published)


def _read_configuration(repository: RosRepository, path: str) -> tuple[list[_Named], str] | None:
    """Return the frames and topics of a configuration, and its description; None if a file is none."""
    name = path.rpartition("/")[2]
    if not name.endswith((".yml", ".yaml")) and name != "dataset.json":
        return None
    text = repository.tree.text(path)
    if "description_file" not in text or "sensors" not in text or len(text) > _MAX_CONFIGURATION_BYTES:
        return None
    if name == "dataset.json":
        return _of_dataset(text)
    if (root := compose_yaml(text)) is None:
        return None
    names = (str(value.value) for key, value in entries_of(root) if key.value == "description_file")
    return list(_find_named(root, 0)), next(names, "")


def _find_named(node: Any, depth: int) -> Iterator[_Named]:
    for key, value in entries_of(node) if depth < 8 else ():
        if isinstance(value, yaml.ScalarNode) and key.value in (*_FRAME_KEYS, "topic_name") and value.value:
            yield _Named(key.value, str(value.value), key.start_mark.line + 1, id(node))
        elif key.value != "calibration_patterns":
            yield from _find_named(value, depth + 1)


def _of_dataset(text: str) -> tuple[list[_Named], str] | None:
    """Return the same of the configuration inside a dataset; the lines are those where the values stand first."""
    try:
        configuration = json.loads(text).get("calibration_config")
    except (ValueError, RecursionError, AttributeError):
        return None
    if not isinstance(configuration, dict):
        return None
    found: list[_Named] = []

    def line_of(key: str, value: str) -> int:
        match = re.search(rf'"{re.escape(key)}"\s*:\s*"{re.escape(value)}"', text)
        return text.count("\n", 0, match.start()) + 1 if match else 1

    sections = [configuration.get("sensors"), configuration.get("additional_tfs"), {"": configuration}]
    for section in sections:
        for each in section.values() if isinstance(section, dict) else ():
            pairs = each.items() if isinstance(each, dict) else ()
            found += [
                _Named(key, value, line_of(key, value), id(each))
                for key, value in pairs
                if key in (*_FRAME_KEYS, "topic_name") and isinstance(value, str) and value
            ]
    description = configuration.get("description_file")
    return found, description if isinstance(description, str) else ""


def _find_description(repository: RosRepository, path: str, text: str) -> _Description | None:
    """Return the description that a configuration names, of a package or beside the configuration."""
    place = repository.place(text.strip()) or join(path.rpartition("/")[0], text.strip())
    if place is None or place not in repository.tree.present:
        return None
    content = repository.tree.text(place)
    root = parse_xml(repository.tree.data(place))
    if root is None:
        return None
    is_xacro = place.endswith(".xacro") or "xacro" in content[:2000]
    if is_xacro:
        links = frozenset(each for each in _LINK_ELEMENT.findall(without_comments(content)) if "$" not in each)
        return _Description(place, links, {}, is_complete=False)
    parents = {}
    for joint in root.iter("joint"):
        parent, child = (joint.find(tag) for tag in ("parent", "child"))
        if parent is not None and child is not None:
            parents[child.get("link", "")] = parent.get("link", "")
    return _Description(place, frozenset(each.get("name", "") for each in root.iter("link")), parents, is_complete=True)


def _static_frames(repository: RosRepository) -> frozenset[str]:
    """Return the arguments of all publishers of static transforms, among which are their frames."""
    starts = (start for launch in repository.launches.values() for start in launch.starts)
    return frozenset(
        argument.lstrip("/")
        for start in starts
        if start.executable and "static_transform_publisher" in start.executable
        for argument in start.arguments
    )


def _check_frames(
    path: str, named: list[_Named], description: _Description, others: frozenset[str]
) -> Iterator[CodeFinding]:
    links = description.links | others
    groups: dict[int, dict[str, _Named]] = {}
    for each in named:
        if each.key not in _FRAME_KEYS:
            continue
        groups.setdefault(each.group, {})[each.key] = each
        if each.value in links:
            continue
        hint = did_you_mean(each.value, links)
        if hint or description.is_complete:
            message = f"{description.path} has no link {quoted(each.value)}{hint}"
            yield fault("no-such-frame", path, each.line, message)
    for group in groups.values():
        parent, child = group.get("parent_link"), group.get("child_link")
        if parent is None or child is None or not {parent.value, child.value} <= description.links:
            continue
        actual = description.parents.get(child.value)
        if description.is_complete and actual is not None and actual != parent.value:
            message = f"the parent of {quoted(child.value)} is {quoted(actual)} in {description.path}"
            yield fault("frame-parent", path, parent.line, message)


def _check_topics(path: str, named: list[_Named], published: frozenset[str]) -> Iterator[CodeFinding]:
    for each in named:
        name = "/" + each.value.lstrip("/")
        if each.key == "topic_name" and name not in published and (hint := did_you_mean(name, published)):
            message = f"no node of this repository publishes {quoted(each.value)}{hint}"
            yield fault("not-connected", path, each.line, message)


MAX_MESH_SIZE = 30.0
"""m: links of robots are smaller, and those in millimetres that are read as metres are larger."""
_VERTEX_LINE = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_HEADER_BYTES, _TRIANGLE_BYTES = 84, 50
"""Bytes of a binary STL before its triangles, and of each."""
_MAX_TRIANGLES = 200_000


def check_meshes(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check the meshes in STL that URDF files name."""
    sizes: dict[str, float | None] = {}
    for path in repository.tree.files:
        root = parse_xml(repository.tree.data(path)) if path.endswith(".urdf") else None
        for mesh in root.iter("mesh") if root is not None else ():
            name = mesh.get("filename", "")
            place = repository.place(name) or join(path.rpartition("/")[0], name.removeprefix("file://"))
            if place is None or not place.lower().endswith(".stl") or place not in repository.tree.present:
                continue
            if place not in sizes:
                sizes[place] = stl_size(repository.tree.data(place))
            size, scale = sizes[place], _largest_factor(mesh.get("scale", "1 1 1"))
            if size is not None and scale is not None and size * scale > MAX_MESH_SIZE:
                message = f"the mesh {quoted(place)} is {size * scale:.3g} m long here, as if its unit were not metres"
                yield fault("mesh-size", path, line_of(mesh), message)


def stl_size(data: bytes) -> float | None:
    """Return the longest side of a mesh's bounding box, in its own unit; None if there is none."""
    points: list[tuple[float, float, float]] = []
    try:
        if (
            len(data) >= _HEADER_BYTES
            and len(data) == _HEADER_BYTES + _TRIANGLE_BYTES * struct.unpack_from("<I", data, 80)[0]
        ):
            end = _HEADER_BYTES + _TRIANGLE_BYTES * _MAX_TRIANGLES
            for numbers in struct.iter_unpack("<12fH", data[_HEADER_BYTES:end]):
                points += [numbers[3:6], numbers[6:9], numbers[9:12]]
        else:
            matches = _VERTEX_LINE.finditer(data)
            points = [(float(x), float(y), float(z)) for x, y, z in (match.groups() for match in matches)]
    except (struct.error, ValueError):
        return None
    sides = [max(values) - min(values) for values in zip(*points, strict=True)]
    return max(sides) if sides and all(map(math.isfinite, sides)) else None


def _largest_factor(text: str) -> float | None:
    """Return the largest of three factors; None if they are not three numbers."""
    try:
        factors = [abs(float(each)) for each in text.split()]
    except ValueError:
        return None
    return max(factors) if len(factors) == 3 and all(map(math.isfinite, factors)) else None
