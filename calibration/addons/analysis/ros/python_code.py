"""Calls of rospy and rclpy in a Python file, by its syntax tree."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field

from calibration.addons.analysis.ros.code import Call, ClientCode, Kind, Quality, short_type
from calibration.addons.analysis.ros.setup_script import parse_python

_KIND_OF_CALL: dict[str, tuple[Kind, int, str, int | None]] = {
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
_QUALITY_ARGUMENT = {"create_publisher": (2, "qos_profile"), "create_subscription": (3, "qos_profile")}
_ANY_PARAMETER = ("allow_undeclared_parameters", "automatically_declare_parameters_from_overrides")


@dataclass
class _Names:
    """Meaning of the names in a Python file, collected before its calls are read."""

    imported: dict[str, list[str]] = field(default_factory=dict)
    texts: dict[str, str | None] = field(default_factory=dict)
    """Names that are assigned one text; None if more than one."""
    values: dict[str, ast.expr | None] = field(default_factory=dict)
    """The same for other values."""


def read_python(path: str, text: str) -> ClientCode:
    """Return the calls of a file; none if it does not parse."""
    module = parse_python(text) if "ros" in text or "rcl" in text else None
    if module is None:
        return ClientCode()
    nodes = list(ast.walk(module))
    names = _collect_names(nodes)
    calls: list[Call] = []
    node_names: list[str] = []
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        called = _resolve_dotted_name(node.func, names)
        calls += _read_calls(node, called, names, path)
        makes_node = called[-2:] == ["rospy", "init_node"] or called[-1:] in (["create_node"], ["Node"])
        if makes_node or _is_base_init(node):
            node_names += _node_name(node, names)
    return ClientCode(
        tuple(sorted(calls, key=lambda each: each.line)),
        tuple(node_names),
        any(each in text for each in _ANY_PARAMETER),
    )


def _collect_names(nodes: list[ast.AST]) -> _Names:
    names = _Names()
    for node in nodes:
        if isinstance(node, ast.Import):
            for each in node.names:
                if each.asname:
                    names.imported[each.asname] = each.name.split(".")
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for each in node.names:
                names.imported[each.asname or each.name] = [*node.module.split("."), each.name]
        elif isinstance(node, ast.Assign) and len(node.targets) == 1:
            target = _name_of_target(node.targets[0])
            if target:
                text = node.value.value if isinstance(node.value, ast.Constant) else None
                names.texts[target] = text if isinstance(text, str) and target not in names.texts else None
                names.values[target] = node.value if target not in names.values else None
    return names


def _name_of_target(node: ast.expr) -> str:
    """Return the text of a name or an attribute of self; empty for others."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self":
        return f"self.{node.attr}"
    return ""


def _resolve_dotted_name(node: ast.expr, names: _Names) -> list[str]:
    """Return the parts of a dotted name, its first one resolved by the imports."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return parts[::-1]
    return [*names.imported.get(node.id, [node.id]), *parts[::-1]]


def _read_calls(node: ast.Call, called: list[str], names: _Names, path: str) -> Iterator[Call]:
    for form, (kind, at, keyword, type_at) in _KIND_OF_CALL.items():
        if called[-form.count(".") - 1 :] != form.split("."):
            continue
        if form.startswith("Action") and "actionlib" in called:
            continue
        name = _constant_text(_argument_of_call(node, at, keyword), names)
        if type_at is not None and len(node.args) <= type_at:
            type_at = None
        of_type = None if type_at is None else short_type(_resolve_dotted_name(node.args[type_at], names))
        quality = None
        if form in _QUALITY_ARGUMENT:
            quality = _quality_of_expression(_argument_of_call(node, *_QUALITY_ARGUMENT[form]), names)
        yield Call(kind, name, of_type, path, node.lineno, quality)
    if called[-1:] == ["declare_parameters"]:
        yield from _declared_together(node, names, path)


def _declared_together(node: ast.Call, names: _Names, path: str) -> Iterator[Call]:
    prefix, each = (
        _constant_text(_argument_of_call(node, 0, "namespace"), names),
        _argument_of_call(node, 1, "parameters"),
    )
    if not isinstance(each, ast.List | ast.Tuple) or prefix is None:
        yield Call("declared parameter", None, None, path, node.lineno)
        return
    for entry in each.elts:
        first = entry.elts[0] if isinstance(entry, ast.Tuple | ast.List) and entry.elts else None
        name = _constant_text(first, names)
        full = None if name is None else f"{prefix}.{name}" if prefix else name
        yield Call("declared parameter", full, None, path, entry.lineno)


def _argument_of_call(node: ast.Call, at: int, keyword: str) -> ast.expr | None:
    if len(node.args) > at:
        return node.args[at]
    return next((each.value for each in node.keywords if each.arg == keyword), None)


def _constant_text(node: ast.expr | None, names: _Names) -> str | None:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    return names.texts.get(_name_of_target(node)) if node is not None else None


def _quality_of_expression(node: ast.expr | None, names: _Names) -> Quality | None:
    """Return the quality of a depth, a profile or a name of one; None if it is something else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        return Quality()
    if node is None:
        return None
    parts = _resolve_dotted_name(node, names)
    if parts[-1:] == ["qos_profile_sensor_data"]:
        return Quality("best effort")
    if isinstance(node, ast.Name | ast.Attribute):
        value = names.values.get(_name_of_target(node))
        return None if value is None or isinstance(value, ast.Name) else _quality_of_expression(value, names)
    if isinstance(node, ast.Call) and _resolve_dotted_name(node.func, names)[-1:] == ["QoSProfile"]:
        return _quality_of_profile(node, names)
    return None


def _quality_of_profile(node: ast.Call, names: _Names) -> Quality | None:
    given = {each.arg: _resolve_dotted_name(each.value, names)[-1:] for each in node.keywords}
    best = {("BEST_EFFORT",): "best effort", ("RELIABLE",): "reliable", (): "reliable"}
    last = {("TRANSIENT_LOCAL",): "transient local", ("VOLATILE",): "volatile", (): "volatile"}
    reliability, durability = (tuple(given.get(each, ())) for each in ("reliability", "durability"))
    if reliability not in best or durability not in last or None in given:
        return None
    return Quality(best[reliability], last[durability])  # type: ignore[arg-type]


def _is_base_init(node: ast.Call) -> bool:
    """Whether it is ``super().__init__(...)``."""
    function = node.func
    return (
        isinstance(function, ast.Attribute)
        and function.attr == "__init__"
        and isinstance(function.value, ast.Call)
        and isinstance(function.value.func, ast.Name)
        and function.value.func.id == "super"
    )


def _node_name(node: ast.Call, names: _Names) -> list[str]:
    name = _constant_text(_argument_of_call(node, 0, "node_name"), names) or _constant_text(
        _argument_of_call(node, 0, "name"), names
    )
    return [name] if name else []
