"""Calls by which the code of a node connects it: topics, services, actions, parameters.

Python is read by its syntax tree, C++ by that of tree-sitter.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import tree_sitter_cpp
from tree_sitter import Language, Node, Parser

from calibration.addons.analysis.ros.tree import PythonFile, argument_of, parse_python

Kind = Literal[
    "publisher", "subscriber", "server", "client", "action server", "action client", "declared parameter", "parameter"
]
Reliability = Literal["reliable", "best effort"]
Durability = Literal["volatile", "transient local"]


@dataclass(frozen=True)
class Quality:
    """Quality of service of a publisher or subscriber, as far as the code says it."""

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"


@dataclass(frozen=True)
class Call:
    """Call of a ROS client library."""

    kind: Kind
    name: str | None
    """Name as written in the code; None if it is not a constant."""
    type: str | None
    """``package/Type``; None if it is not known. None for parameters."""
    path: str
    line: int
    quality: Quality | None = None
    """Quality of service; None if it is unknown, and for ROS 1."""


@dataclass(frozen=True)
class ClientCode:
    """Uses of the ROS client library in one source file."""

    calls: tuple[Call, ...] = ()
    node_names: tuple[str, ...] = ()
    """Names that nodes are created with."""
    takes_any_parameter: bool = False
    """Whether nodes accept parameters that they do not declare."""


def short_type(parts: list[str]) -> str | None:
    """Return ``package/Type`` of ``package.msg.Type`` or ``package::msg::Type``; None if it is no type of a package."""
    kept = [each for each in parts if each not in ("msg", "srv", "action", "")]
    return "/".join(kept) if len(kept) == 2 else None


_KIND_OF_PYTHON_CALL: dict[str, tuple[Kind, int, str, int | None]] = {
    "create_publisher": ("publisher", 1, "topic", 0),
    "create_subscription": ("subscriber", 1, "topic", 0),
    "create_service": ("server", 1, "srv_name", 0),
    "create_client": ("client", 1, "srv_name", 0),
    "ActionClient": ("action client", 2, "action_name", 1),
    "ActionServer": ("action server", 2, "action_name", 1),
    "rospy.Publisher": ("publisher", 0, "name", 1),
    "rospy.Subscriber": ("subscriber", 0, "name", 1),
    "rospy.Service": ("server", 0, "name", 1),
    "rospy.ServiceProxy": ("client", 0, "name", 1),
    "actionlib.SimpleActionClient": ("action client", 0, "ns", 1),
    "actionlib.SimpleActionServer": ("action server", 0, "name", 1),
    "declare_parameter": ("declared parameter", 0, "name", None),
    "get_parameter": ("parameter", 0, "name", None),
    "get_parameter_or": ("parameter", 0, "name", None),
    "rospy.get_param": ("parameter", 0, "param_name", None),
    "rospy.has_param": ("parameter", 0, "param_name", None),
}
"""Called functions, by the end of their name: kind of the call, index and keyword of the argument with the name,
index of the type."""
_QUALITY_ARGUMENT_IN_PYTHON = {"create_publisher": (2, "qos_profile"), "create_subscription": (3, "qos_profile")}
_ANY_PARAMETER = ("allow_undeclared_parameters", "automatically_declare_parameters_from_overrides")
_RELIABILITY_OF_POLICY: dict[str, Reliability] = {"BEST_EFFORT": "best effort", "RELIABLE": "reliable"}
_DURABILITY_OF_POLICY: dict[str, Durability] = {"TRANSIENT_LOCAL": "transient local", "VOLATILE": "volatile"}


def read_python(path: str, text: str) -> ClientCode:
    """Return the calls of a file; none if it does not parse."""
    file = parse_python(text) if "ros" in text or "rcl" in text else None
    if file is None:
        return ClientCode()
    calls: list[Call] = []
    names: list[str] = []
    for node, called in file.calls():
        calls += _read_python_calls(node, called, file, path)
        makes_node = called[-2:] == ["rospy", "init_node"] or called[-1:] in (["create_node"], ["Node"])
        if makes_node or _is_base_init(node):
            given = (file.text(argument_of(node, 0, keyword)) for keyword in ("node_name", "name"))
            names += list(filter(None, given))[:1]
    calls.sort(key=lambda each: each.line)
    return ClientCode(tuple(calls), tuple(names), any(each in text for each in _ANY_PARAMETER))


def _read_python_calls(node: ast.Call, called: list[str], file: PythonFile, path: str) -> Iterator[Call]:
    for form, (kind, at, keyword, type_at) in _KIND_OF_PYTHON_CALL.items():
        if called[-form.count(".") - 1 :] != form.split(".") or (form.startswith("Action") and "actionlib" in called):
            continue
        has_type = type_at is not None and len(node.args) > type_at
        of_type = short_type(file.dotted_name(node.args[type_at or 0])) if has_type else None
        quality = None
        if form in _QUALITY_ARGUMENT_IN_PYTHON:
            quality = _quality_of_python_expression(argument_of(node, *_QUALITY_ARGUMENT_IN_PYTHON[form]), file)
        yield Call(kind, file.text(argument_of(node, at, keyword)), of_type, path, node.lineno, quality)
    if called[-1:] == ["declare_parameters"]:
        yield from _declared_together(node, file, path)


def _declared_together(node: ast.Call, file: PythonFile, path: str) -> Iterator[Call]:
    prefix, entries = file.text(argument_of(node, 0, "namespace")), argument_of(node, 1, "parameters")
    if not isinstance(entries, ast.List | ast.Tuple) or prefix is None:
        yield Call("declared parameter", None, None, path, node.lineno)
        return
    for entry in entries.elts:
        name = file.text(entry.elts[0]) if isinstance(entry, ast.Tuple | ast.List) and entry.elts else None
        full = f"{prefix}.{name}" if prefix and name is not None else name
        yield Call("declared parameter", full, None, path, entry.lineno)


def _quality_of_python_expression(node: ast.expr | None, file: PythonFile) -> Quality | None:
    """Return the quality of a depth, a profile or a name of one; None if it is something else."""
    for each in (node, file.value(node)):
        if isinstance(each, ast.Constant) and isinstance(each.value, int):
            return Quality()
        if each is not None and file.dotted_name(each)[-1:] == ["qos_profile_sensor_data"]:
            return Quality("best effort")
        if isinstance(each, ast.Call) and file.dotted_name(each.func)[-1:] == ["QoSProfile"]:
            return _quality_of_profile(each, file)
    return None


def _quality_of_profile(node: ast.Call, file: PythonFile) -> Quality | None:
    given = {each.arg: "".join(file.dotted_name(each.value)[-1:]) for each in node.keywords}
    reliability = _RELIABILITY_OF_POLICY.get(given.get("reliability", "RELIABLE"))
    durability = _DURABILITY_OF_POLICY.get(given.get("durability", "VOLATILE"))
    return None if reliability is None or durability is None or None in given else Quality(reliability, durability)


def _is_base_init(node: ast.Call) -> bool:
    """Whether it is ``super().__init__(...)``."""
    match node.func:
        case ast.Attribute(ast.Call(ast.Name("super")), "__init__"):
            return True
    return False


_KIND_OF_CPP_CALL: dict[str, tuple[Kind, int]] = {
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
_QUALITY_ARGUMENT_IN_CPP = {"create_publisher": 1, "create_subscription": 1}
_POINTER_TYPES = ("ConstPtr", "Ptr", "SharedPtr", "ConstSharedPtr", "UniquePtr", "Request", "Response")
_MAX_CODE_BYTES = 2_000_000
"""Limit of a file's size; generated code is larger."""
_CPP_PARSER = Parser(Language(tree_sitter_cpp.language()))


@dataclass
class _CppNames:
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
    file = _collect_cpp_names(path, nodes)
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


def _collect_cpp_names(path: str, nodes: list[Node]) -> _CppNames:
    file = _CppNames(path)
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


def _collect_variable(node: Node, file: _CppNames) -> None:
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


def _collect_callback(node: Node, file: _CppNames) -> None:
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


def _type_of(text: str, file: _CppNames) -> str | None:
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


def _read_call(node: Node, file: _CppNames) -> Iterator[Call]:
    owner, name, argument = _called_function(node)
    if name not in _KIND_OF_CPP_CALL:
        return
    kind, at = _KIND_OF_CPP_CALL[name]
    given = _arguments_of_call(node)
    if len(given) <= at:
        return
    text = _constant_text_in_cpp(given[at], file)
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
    if name in _QUALITY_ARGUMENT_IN_CPP and len(given) > _QUALITY_ARGUMENT_IN_CPP[name]:
        quality = _quality_of_cpp_expression(_source_of_node(given[_QUALITY_ARGUMENT_IN_CPP[name]]), file)
    yield Call(kind, text, found, file.path, node.start_point[0] + 1, quality)


def _type_of_callback(given: list[Node], file: _CppNames) -> str | None:
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


def _constant_text_in_cpp(node: Node, file: _CppNames) -> str | None:
    if node.type == "string_literal":
        return _string_literals(node)[0]
    return file.texts.get(_source_of_node(node)) if node.type in ("identifier", "field_identifier") else None


def _quality_of_cpp_expression(text: str, file: _CppNames) -> Quality | None:
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
