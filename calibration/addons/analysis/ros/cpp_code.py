"""Calls of roscpp and rclcpp in a C++ file, by tree-sitter's syntax tree."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import tree_sitter_cpp
from tree_sitter import Language, Node, Parser

from calibration.addons.analysis.ros.code import Call, ClientCode, Kind, Quality, short_type

_KIND_OF_CALL: dict[str, tuple[Kind, int]] = {
    "create_publisher": ("publisher", 0),
    "create_subscription": ("subscriber", 0),
    "create_service": ("server", 0),
    "create_client": ("client", 0),
    "advertise": ("publisher", 0),
    "subscribe": ("subscriber", 0),
    "advertiseService": ("server", 0),
    "serviceClient": ("client", 0),
    "rclcpp_action::create_server": ("action server", 1),
    "rclcpp_action::create_client": ("action client", 1),
    "declare_parameter": ("declared parameter", 0),
    "get_parameter": ("parameter", 0),
    "get_parameter_or": ("parameter", 0),
    "param": ("parameter", 0),
    "getParam": ("parameter", 0),
    "hasParam": ("parameter", 0),
}
"""Called functions: kind of the call, and index of the argument with the name."""
_QUALITY_ARGUMENT = {"create_publisher": 1, "create_subscription": 1}
_ANY_PARAMETER = ("allow_undeclared_parameters", "automatically_declare_parameters_from_overrides")
_POINTER_TYPES = ("ConstPtr", "Ptr", "SharedPtr", "ConstSharedPtr", "UniquePtr", "Request", "Response")
_MAX_CODE_BYTES = 2_000_000
"""Limit of a file's size; generated code is larger."""
_CPP_PARSER = Parser(Language(tree_sitter_cpp.language()))


@dataclass
class _File:
    """Meaning of the names in a C++ file, collected before its calls are read."""

    path: str
    aliases: dict[str, list[str]] = field(default_factory=dict)
    """Parts of the types that have a short name here."""
    texts: dict[str, str | None] = field(default_factory=dict)
    callbacks: dict[str, str | None] = field(default_factory=dict)
    """Type of the first parameter of each function."""
    private: set[str] = field(default_factory=set)
    """Node handles of ROS 1 that are made with ``~``."""
    elsewhere: set[str] = field(default_factory=set)
    """Node handles of ROS 1 that are made with another namespace."""
    initial: dict[str, str] = field(default_factory=dict)
    """Source of the initial value of each variable."""


def read_cpp(path: str, text: str) -> ClientCode:
    """Return the calls of a file."""
    data = text.encode()
    if len(data) > _MAX_CODE_BYTES or ("ros" not in text and "rcl" not in text):
        return ClientCode()
    nodes = list(_walk_nodes(_CPP_PARSER.parse(data).root_node))
    file = _collect_names(path, nodes)
    calls = [call for node in nodes if node.type == "call_expression" for call in _read_call(node, file)]
    names = [name for node in nodes for name in _node_names(node)]
    return ClientCode(tuple(calls), tuple(names), any(each in text for each in _ANY_PARAMETER))


def _walk_nodes(root: Node) -> Iterator[Node]:
    """Yield all nodes, those of a file in their order, without recursion."""
    open_nodes = [root]
    while open_nodes:
        node = open_nodes.pop()
        yield node
        open_nodes += reversed(node.named_children)


def _source_of_node(node: Node | None) -> str:
    return "" if node is None or node.text is None else node.text.decode(errors="replace")


def _collect_names(path: str, nodes: list[Node]) -> _File:
    file = _File(path)
    for node in nodes:
        if node.type == "alias_declaration":
            file.aliases[_source_of_node(node.child_by_field_name("name"))] = _parts_of_name(
                _source_of_node(node.child_by_field_name("type"))
            )
        elif node.type == "using_declaration":
            parts = _parts_of_name(_source_of_node(node.named_children[0])) if node.named_children else []
            if parts:
                file.aliases[parts[-1]] = parts
        elif node.type in ("init_declarator", "field_declaration"):
            _collect_variable(node, file)
        elif node.type == "function_definition":
            _collect_callback(node, file)
        elif node.type == "field_initializer" and len(node.named_children) == 2:
            name, value = node.named_children
            if literals := _string_literals(value):
                (file.private if literals == ["~"] else file.elsewhere).add(_source_of_node(name))
    return file


def _collect_variable(node: Node, file: _File) -> None:
    declarator = node.child_by_field_name("declarator")
    value = node.child_by_field_name("value") or node.child_by_field_name("default_value")
    while declarator is not None and declarator.type not in ("identifier", "field_identifier"):
        declarator = declarator.child_by_field_name("declarator") or next(iter(declarator.named_children[-1:]), None)
    name = _source_of_node(declarator)
    if not name or value is None:
        return
    literals = _string_literals(value)
    is_text = len(literals) == 1 and value.type in ("string_literal", "initializer_list", "argument_list")
    file.texts[name] = literals[0] if is_text and name not in file.texts else None
    file.initial[name] = _source_of_node(value) if name not in file.initial else ""
    if value.type in ("argument_list", "initializer_list") and literals:
        (file.private if literals == ["~"] else file.elsewhere).add(name)


def _collect_callback(node: Node, file: _File) -> None:
    declarator = node.child_by_field_name("declarator")
    while declarator is not None and declarator.type != "function_declarator":
        declarator = declarator.child_by_field_name("declarator")
    if declarator is None:
        return
    name = _parts_of_name(_source_of_node(declarator.child_by_field_name("declarator")))[-1:]
    parameters = declarator.child_by_field_name("parameters")
    given = [each for each in parameters.named_children if each.type == "parameter_declaration"] if parameters else []
    if name and given:
        found = _type_of(_source_of_node(given[0].child_by_field_name("type")), file)
        file.callbacks[name[0]] = found if name[0] not in file.callbacks else None


def _parts_of_name(text: str) -> list[str]:
    """Return the parts of a qualified name; of the type in a template's brackets if it is a pointer to one."""
    inner = re.search(r"(?:shared_ptr|unique_ptr|MessageEvent)<\s*(?:const\s+)?([\w:]+)", text)
    parts = re.findall(r"\w+", (inner[1] if inner else text.partition("<")[0]))
    parts = [each for each in parts if each not in ("const", "typename")]
    while parts and parts[-1] in _POINTER_TYPES:
        parts.pop()
    return parts


def _type_of(text: str, file: _File) -> str | None:
    parts = _parts_of_name(text)
    if parts and parts[0] in file.aliases:
        parts = [*file.aliases[parts[0]], *parts[1:]]
    return short_type([each for each in parts if each not in _POINTER_TYPES])


def _called_function(node: Node) -> tuple[str, str, str]:
    """Return object, name and template argument of a call."""
    function, owner, argument = node.child_by_field_name("function"), "", ""
    if function is not None and function.type == "field_expression":
        owner = _source_of_node(function.child_by_field_name("argument"))
        function = function.child_by_field_name("field")
    if function is None:
        return "", "", ""
    name = re.sub(r"<.*", "", _source_of_node(function), flags=re.DOTALL)
    match = re.search(r"<(.*)>", _source_of_node(function), flags=re.DOTALL)
    argument = match[1].strip() if match else ""
    return owner, name, argument


def _arguments_of_call(node: Node) -> list[Node]:
    given = node.child_by_field_name("arguments")
    return [] if given is None else [each for each in given.named_children if each.type != "comment"]


def _read_call(node: Node, file: _File) -> Iterator[Call]:
    owner, name, argument = _called_function(node)
    if name not in _KIND_OF_CALL:
        return
    kind, at = _KIND_OF_CALL[name]
    given = _arguments_of_call(node)
    if len(given) <= at:
        return
    text = _constant_text(given[at], file)
    if name in ("param", "getParam", "hasParam") and text is not None and owner in file.private:
        text = f"~{text}"
    if name in ("advertise", "subscribe", "advertiseService", "serviceClient"):
        if not owner:
            return
        if owner in file.elsewhere:
            text = None
        if text is not None and owner in file.private and not text.startswith(("/", "~")):
            text = f"~{text}"
    found = None if kind in ("parameter", "declared parameter") else _type_of(argument, file)
    if found is None and name in ("subscribe", "advertiseService"):
        found = _type_of_callback(given, file)
    quality = None
    if name in _QUALITY_ARGUMENT and len(given) > _QUALITY_ARGUMENT[name]:
        quality = _quality_of_expression(_source_of_node(given[_QUALITY_ARGUMENT[name]]), file)
    yield Call(kind, text, found, file.path, node.start_point[0] + 1, quality)


def _type_of_callback(given: list[Node], file: _File) -> str | None:
    names = [
        _parts_of_name(_source_of_node(each))[-1:]
        for each in given[1:]
        if re.fullmatch(r"&?[\w:]+", _source_of_node(each))
    ]
    found = {file.callbacks.get(name[0]) for name in names if name and name[0] in file.callbacks}
    return found.pop() if len(found) == 1 else None


def _string_literals(node: Node) -> list[str]:
    return [
        "".join(_source_of_node(part) for part in each.named_children if part.type == "string_content")
        for each in _walk_nodes(node)
        if each.type == "string_literal"
    ]


def _constant_text(node: Node, file: _File) -> str | None:
    if node.type == "string_literal":
        return _string_literals(node)[0]
    return file.texts.get(_source_of_node(node)) if node.type in ("identifier", "field_identifier") else None


def _quality_of_expression(text: str, file: _File) -> Quality | None:
    """Return the quality that an expression makes; None if it is not known."""
    text = file.initial.get(text, text)
    if not re.search(r"^\d+$|QoS\(", text) or "profile" in text.lower():
        return None
    best = "best_effort" in text or ("SensorDataQoS" in text and ".reliable" not in text)
    return Quality(
        "best effort" if best else "reliable", "transient local" if "transient_local" in text else "volatile"
    )


def _node_names(node: Node) -> Iterator[str]:
    """Yield the names of nodes: of base classes in initialisers, of factories, of ``ros::init``."""
    if node.type == "field_initializer" and _parts_of_name(_source_of_node(node.named_children[0]))[-1:] in (
        ["Node"],
        ["LifecycleNode"],
    ):
        yield from _string_literals(node)[:1]
    elif node.type == "call_expression":
        _, name, argument = _called_function(node)
        if name in ("rclcpp::Node::make_shared", "ros::init") or (
            name in ("std::make_shared", "make_shared") and _parts_of_name(argument)[-1:] == ["Node"]
        ):
            yield from _string_literals(node)[:1]
