"""Launch files: the nodes they start, the files they include and the parameters they set, read without running them.

Here those in XML and YAML; `launch_python` reads those in Python.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree.ElementTree import Element

import yaml

from calibration.addons.analysis.ros.tree import (
    LINE_KEY,
    attributes_of,
    compose_yaml,
    entries_of,
    join,
    line_of,
    parse_xml,
)

_PACKAGE_SUBSTITUTION = re.compile(r"\$\((?:find|find-pkg-share)\s+([\w-]+)\)")
_FOLDER_SUBSTITUTION = re.compile(r"\$\(dirname\)")


@dataclass(frozen=True)
class Remapping:
    """Name that a node is given in place of another one."""

    old: str | None
    new: str | None
    """The new name; like the old one None if it is unknown."""
    line: int


@dataclass(frozen=True)
class LaunchParameter:
    """Parameter that a launch file or a file of parameters sets."""

    name: str
    path: str
    line: int


@dataclass(frozen=True)
class NodeStart:
    """Node that a launch file starts."""

    package: str | None
    executable: str | None
    name: str | None
    """Name of the node; None if it is not given, or unknown."""
    path: str
    line: int
    namespace: str | None = ""
    """Namespace of the node; None if it is unknown."""
    is_named: bool = True
    """Whether the launch file gives a name."""
    conditional: bool = False
    remappings: tuple[Remapping, ...] = ()
    parameters: tuple[LaunchParameter, ...] = ()
    parameter_files: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Include:
    """Launch file that another one includes."""

    file: str | None
    path: str
    line: int
    arguments: Mapping[str, int] = field(default_factory=dict)
    """Lines of the arguments by name."""
    namespace: str | None = ""
    conditional: bool = False
    passes_all: bool = False


@dataclass(eq=False)
class Launch:
    """A launch file."""

    path: str
    starts: list[NodeStart] = field(default_factory=list)
    includes: list[Include] = field(default_factory=list)
    arguments: dict[str, bool] = field(default_factory=dict)
    """Declared arguments, and whether each has a value."""
    used: list[tuple[str, int]] = field(default_factory=list)
    """Arguments that are used, with their lines."""
    files: list[tuple[str, int]] = field(default_factory=list)
    """Files of packages that are named, ``package://name/path``, with their lines."""
    unresolved: list[str] = field(default_factory=list)
    """Messages about parts that could not be read."""


def with_packages(text: str, path: str) -> str:
    """Return a text with ``package://name`` for the folders of packages; other substitutions stay ``$(...)``."""
    text = _PACKAGE_SUBSTITUTION.sub(lambda match: f"package://{match[1]}", text)
    return _FOLDER_SUBSTITUTION.sub(lambda _: f"repository://{path.rpartition('/')[0]}", text)


def known(text: str | None) -> str | None:
    """Return a text without substitutions; None for others."""
    return None if text is None or "$(" in text else text


def package_of(text: str) -> tuple[str, str] | None:
    """Return package and path of ``package://name/path``; None for others, and for paths with substitutions."""
    match = re.fullmatch(r"(?:file://)?package://([\w-]+)/+([^$*?\[\]{}]+)", text)
    if match is None or (path := join("", match[2])) is None:
        return None
    return match[1], path


def resolved(namespace: str | None, name: str) -> str | None:
    """Return the full name of a relative, absolute or private one; the private ones as ``/namespace/~name``."""
    if name.startswith("/"):
        return "/" + name.strip("/")
    if namespace is None:
        return None
    return f"/{namespace.strip('/')}/{name}".replace("//", "/")


_MAX_ELEMENTS = 20_000
_MAX_GROUP_DEPTH = 50
_ARGUMENT_SUBSTITUTIONS = ("$(arg ", "$(var ")
_NODE_TAGS = ("node", "test", "lifecycle_node")
_KEYS_WITH_LINE = ("file", "exec", "from")
"""Keys of YAML whose line is that of their element."""
_NAMESPACE_TAGS = ("push-ros-namespace", "push_ros_namespace")


@dataclass(frozen=True)
class _Scope:
    """Settings that an element inherits from the elements around it."""

    namespace: str | None = ""
    conditional: bool = False
    remappings: tuple[Remapping, ...] = ()

    def inside(self, namespace: str | None) -> "_Scope":
        """Return the scope in a further namespace, relative or absolute."""
        if namespace is None or self.namespace is None:
            return replace(self, namespace=None)
        whole = namespace if namespace.startswith("/") else f"{self.namespace}/{namespace}"
        return replace(self, namespace=whole.strip("/"))


def read_launch_xml(path: str, data: bytes) -> Launch | None:
    """Read a launch file in XML; None if it is no such file."""
    root = parse_xml(data)
    return _read_launch(path, root) if root is not None and root.tag == "launch" else None


def read_launch_yaml(path: str, text: str) -> Launch | None:
    """Read a launch file in YAML; None if it is no such file."""
    entries = entries_of(compose_yaml(text))
    return (
        _read_launch(path, _Elements().of(entries[0][1])) if [key.value for key, _ in entries] == ["launch"] else None
    )


class _Elements:
    """Elements of a document in YAML, as those of XML; aliases of aliases are cut off."""

    def __init__(self) -> None:
        self._left = _MAX_ELEMENTS

    def of(self, node: Any) -> Element:
        """Return the root, of a list of entries."""
        root = Element("launch")
        self._add_entries(root, node, 0)
        return root

    def _add_entries(self, parent: Element, node: Any, depth: int) -> None:
        """Add the entries of a list, each ``tag: content``."""
        for entry in node.value if isinstance(node, yaml.SequenceNode) else ():
            for key, value in entries_of(entry):
                self._add_element(parent, str(key.value), value, key.start_mark.line + 1, depth)

    def _add_element(self, parent: Element, tag: str, value: Any, line: int, depth: int) -> None:
        self._left -= 1
        if self._left < 0 or depth > _MAX_GROUP_DEPTH:
            return
        child = Element(tag, {LINE_KEY: str(line)})
        parent.append(child)
        if isinstance(value, yaml.SequenceNode):  # a group
            self._add_entries(child, value, depth + 1)
            return
        for key, inner in entries_of(value):
            name = str(key.value)
            if isinstance(inner, yaml.ScalarNode):
                child.set(name, str(inner.value))
                if name in _KEYS_WITH_LINE:
                    child.set(LINE_KEY, str(key.start_mark.line + 1))
            elif isinstance(inner, yaml.SequenceNode):
                for each in inner.value:
                    if isinstance(each, yaml.MappingNode):
                        self._add_element(child, name, each, each.start_mark.line + 1, depth + 1)


def _read_launch(path: str, root: Element) -> Launch:
    launch = Launch(path)
    _read_children(root, _Scope(), launch)
    for element in root.iter():
        for text in (*attributes_of(element).values(), element.text or ""):
            line = line_of(element)
            launch.used += [(name, line) for name in _used_arguments(text)]
            if "$(find" in text or "package://" in text:
                launch.files += [(each, line) for each in with_packages(text, path).split()]
    return launch


def _used_arguments(text: str) -> Iterator[str]:
    for mark in _ARGUMENT_SUBSTITUTIONS:
        for part in text.split(mark)[1:]:
            yield part.partition(")")[0].strip()


def _read_children(element: Element, scope: _Scope, launch: Launch) -> None:
    for child in element:
        inner = replace(scope, conditional=scope.conditional or bool({"if", "unless"} & set(child.keys())))
        text = {name: with_packages(value, launch.path) for name, value in attributes_of(child).items()}
        tag, line = str(child.tag), line_of(child)
        if tag in _NAMESPACE_TAGS:
            scope = scope.inside(known(text.get("namespace")))
        elif tag == "group":
            _read_children(child, inner.inside(known(text["ns"])) if text.get("ns") else inner, launch)
        elif tag == "remap":
            scope = replace(scope, remappings=(*scope.remappings, _read_remapping(text, line)))
        elif tag == "arg" and "name" in text:
            launch.arguments[text["name"]] = "default" in text or "value" in text
        elif tag == "include":
            launch.includes.append(_read_include(child, text, inner, launch.path))
        elif tag in _NODE_TAGS:
            launch.starts.append(_read_start(child, text, inner, launch.path))


def _read_remapping(text: dict[str, str], line: int) -> Remapping:
    return Remapping(known(text.get("from")), known(text.get("to")), line)


def _read_include(element: Element, text: dict[str, str], scope: _Scope, path: str) -> Include:
    if text.get("ns"):
        scope = scope.inside(known(text["ns"]))
    given = {each.get("name", ""): line_of(each) for each in element if each.tag in ("arg", "let") and each.get("name")}
    return Include(
        text.get("file"), path, line_of(element), given, scope.namespace, scope.conditional, "pass_all_args" in text
    )


def _read_start(element: Element, text: dict[str, str], scope: _Scope, path: str) -> NodeStart:
    namespace = text.get("ns") or text.get("namespace")
    if namespace:
        scope = scope.inside(known(namespace))
    remappings, parameters, files = list(scope.remappings), [], []
    for child in element:
        inner = {name: with_packages(value, path) for name, value in attributes_of(child).items()}
        if child.tag == "remap":
            remappings.append(_read_remapping(inner, line_of(child)))
        elif child.tag == "param" and "from" in inner:
            files.append(inner["from"])
        elif child.tag in ("param", "rosparam"):
            if "file" in inner:
                files.append(inner["file"])
            name = known(inner.get("name") or inner.get("param"))
            if name:
                parameters.append(LaunchParameter(name, path, line_of(child)))
    return NodeStart(
        package=known(text.get("pkg")),
        executable=known(text.get("type") or text.get("exec")),
        name=known(text.get("name") or text.get("test-name")),
        path=path,
        line=line_of(element),
        namespace=scope.namespace,
        is_named="name" in text,
        conditional=scope.conditional,
        remappings=tuple(remappings),
        parameters=tuple(parameters),
        parameter_files=tuple(files),
        arguments=tuple((text.get("args") or "").split()),
    )
